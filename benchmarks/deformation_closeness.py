"""How near kamikazes of objective deformation come to the margin: exact of the basic car, found by search of any other.

Per car, over the first attempts of each φ (their number is --episodes): the mean planned deformation (an attempt
without a hit counts as η_max), the margin of the same attempts, closeness = the ratio of the two, and milliseconds
that an exact margin takes. With --budgets also what the search that knows nothing of the car finds in the same
attempts, one at a time, over the exact margin, and how long it takes. With --informed also what two others reach in
the same attempts, with so many simulations a decision: a kamikaze who sees the car as this one does, and one who is
told the car's true state in every tick, but not the draws to come (informed_kamikaze.py). What the first gains is what
the budget costs, what the second gains on the first is what the sensor costs, and what is left to the margin is, but
for what a search misses, the price of not knowing the draws. With --controller another car than the basic one: then
only what the search that knows nothing finds is known. Of several multipliers also how each differs from the next, in
pairs of attempts that have their draws in common, and Cohen's d of the first against the last.

    python benchmarks/deformation_closeness.py [--safe DIR] [--safe-count N] [--episodes N] [--budgets N ...] [--json]
    python benchmarks/deformation_closeness.py --informed 1000 20000
    python benchmarks/deformation_closeness.py --controller cal --budgets 512 1024
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from informed_kamikaze import InformedAdversary
from skd_evaluator.assessing.asked import scenario_for
from skd_evaluator.assessing.pipeline import planners_of
from skd_evaluator.campaign.judge.assessment import Assessment, assess
from skd_evaluator.campaign.plan.options import SYNTHETIC
from skd_evaluator.campaign.plan.plan import Plan, safe_trajectories, split_episode_id
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.campaign.run.workers import InProcessRunner, available_workers
from skd_evaluator.margin.assessment_margin import warm_up_margins
from skd_evaluator.margin.exact.exact import exact_margin
from skd_evaluator.margin.search.search import search_margin
from skd_evaluator.margin.ways.foretold import foretold
from skd_evaluator.measure.distances.deformation import deformation
from skd_evaluator.measure.statistics.clustered import clustered_mean
from skd_evaluator.measure.statistics.statistics import normal_interval
from skd_sim.choices.objective import Objective
from skd_sim.controllers import PAPER_MULTIPLIERS
from skd_sim.episode.episode import Episode, EpisodeLog
from skd_sim.errors import UsageError


def _silent(_label: str, _done: int, _total: int) -> None:
    pass


def _tried(assessment: Assessment) -> list[EpisodeLog]:
    """Return the attempts of the margin: those that were run after them are there for what others failed."""
    everything = [log for group in assessment.kamikaze for log in (*group.logs, *group.misses)]
    count = assessment.plan.kamikaze_count
    return [log for log in everything if split_episode_id(log.episode.episode_id)[2] < count]


def _exact(log: EpisodeLog) -> tuple[float, float, float]:
    """Return exact margin (η_max where there is none below), its gap, both in m, and the seconds that it took.

    Margin and gap are nan where the search has no room.
    """
    eta_max = log.episode.scenario.eta_max
    begin = time.perf_counter()
    try:
        found = exact_margin(log.episode, eta_max)
    except UsageError:
        return math.nan, math.nan, time.perf_counter() - begin
    seconds = time.perf_counter() - begin
    return (eta_max, 0.0, seconds) if found is None else (found.distance, found.gap, seconds)


def _search(job: tuple[EpisodeLog, int, bool]) -> tuple[float, float]:
    """Return what the search finds (η_max where that is less), m, and the seconds that it took."""
    log, budget, with_start = job
    begin = time.perf_counter()
    found = search_margin(log.episode, budget, [log.trajectory.positions] if with_start else ()).way
    eta_max = log.episode.scenario.eta_max
    return eta_max if found is None else found.distance, time.perf_counter() - begin


def _attempt(job: tuple[Episode, bool]) -> float:
    """Return what the deformation of an episode is (η_max where that is less, or nobody was hit), m.

    With the second entry true by a kamikaze who is told the car's state, else by the one that the episode names.
    """
    episode, informed = job
    log = run_episode(episode, adversary=InformedAdversary(episode, episode.simulations) if informed else None)
    eta_max = episode.scenario.eta_max
    if not log.hit:
        return eta_max
    assert episode.safe_trajectory is not None
    ticks = log.impact_time / episode.scenario.time_step
    return min(eta_max, deformation(episode.safe_trajectory.positions, log.trajectory.positions, ticks))


def _informed(row: dict[str, Any], episodes: Sequence[Episode], simulations: int, runner: InProcessRunner) -> None:
    """Add to a row what those reach who have so many simulations, by the sensor and told the car's state.

    Each has mean deformation, closeness (both over all attempts), share of attempts that reached η_max, and the mean
    of what it differs from the assessment's kamikaze with its 95 % interval, in pairs of one episode.
    """
    for kind in (False, True):
        jobs = [(replace(episode, simulations=simulations), kind) for episode in episodes]
        reached = np.array(list(runner.map(_attempt, jobs)))
        apart = reached - np.array([row["attempts"][episode.episode_id] for episode in episodes])
        known = [row["margins"][episode.episode_id] for episode in episodes if episode.episode_id in row["margins"]]
        solved = np.array([episode.episode_id in row["margins"] for episode in episodes])
        row["informed"][f"{'car known' if kind else 'sensor'}, {simulations} simulations"] = {
            "deformation": float(reached.mean()),
            "closeness": float(reached[solved].mean() / np.mean(known)),
            "failed": float((reached >= episodes[0].scenario.eta_max).mean()),
            "difference": float(apart.mean()),
            "ci95": normal_interval(apart),
        }


def _row(plan: Plan, budgets: Sequence[int], informed: Sequence[int], runner: InProcessRunner) -> dict[str, Any]:
    safe = safe_trajectories(plan, runner)
    runner.start(planners_of(plan, [Objective.DEFORMATION]))
    assessment = assess(plan, safe, runner, _silent)
    known = foretold(plan.car, plan.scenario)
    tried = _tried(assessment)
    reached = {}
    for log in tried:
        _, index, attempt = split_episode_id(log.episode.episode_id)
        reached[log.episode.episode_id] = float(assessment.attempt_deformations[index][attempt])
    row: dict[str, Any] = {"controller": plan.controller, "multiplier": plan.multiplier, "attempts": reached}
    row["deformation"] = float(np.mean(list(reached.values())))
    row["hits"] = float(np.mean([log.hit for log in tried]))
    exact = np.array(list(runner.map(_exact, tried))) if known else np.full((len(tried), 3), np.nan)
    solved = ~np.isnan(exact[:, 0])
    numbers = [log.episode.episode_id for log in tried]
    row["margins"] = {
        number: float(value) for number, value, there in zip(numbers, exact[:, 0], solved, strict=True) if there
    }
    row["margin"] = float(exact[solved, 0].mean()) if solved.any() else None
    row["closeness"] = (
        float(np.mean([reached[number] for number in row["margins"]])) / row["margin"] if row["margin"] else None
    )
    row["margin_ms"], row["margin_ms_worst"] = (
        (1e3 * float(exact[:, 2].mean()), 1e3 * float(exact[:, 2].max())) if known else (None, None)
    )
    row["gap_mean"], row["gap_worst"] = (
        (float(exact[solved, 1].mean()), float(exact[solved, 1].max())) if solved.any() else (None, None)
    )
    row["without_room"] = int((~solved).sum()) if known else None
    row["searches"] = {}
    for budget in budgets:
        for with_start in (False, True):
            found = np.array(list(runner.map(_search, [(log, budget, with_start) for log in tried])))
            row["searches"][f"{budget}{' from the kamikaze' if with_start else ''}"] = {
                "mean": float(found[:, 0].mean()),
                "over_exact": float(found[solved, 0].mean() / exact[solved, 0].mean()) if known else None,
                "ms": 1e3 * float(found[:, 1].mean()),
            }
    row["informed"] = {}
    for simulations in informed:
        _informed(row, [log.episode for log in tried], simulations, runner)
    return row


def _show(row: dict[str, Any]) -> None:
    name = f"C = {row['multiplier']:g}" if row["controller"] == "basic" else row["controller"]

    def number(value: float | None, digits: int = 3) -> str:
        return "-" if value is None else f"{value:.{digits}f}"

    figures = (
        f"{name:>10}: hit {row['hits']:6.1%}",
        f"deformation {number(row['deformation'])}",
        f"margin {number(row['margin'])}",
        f"closeness {number(row['closeness'])}",
        f"exact margin {number(row['margin_ms'], 1)} ms (worst {number(row['margin_ms_worst'], 0)})",
        f"gap {number(row['gap_mean'], 4)} m (worst {number(row['gap_worst'])})",
        f"no room in {'-' if row['without_room'] is None else row['without_room']}",
    )
    print(", ".join(figures), flush=True)
    for budget, one in row["searches"].items():
        print(
            f"{'':>12}budget {budget}: {one['mean']:.3f} m, over exact {number(one['over_exact'])}, {one['ms']:.0f} ms"
        )
    for who, one in row["informed"].items():
        low, high = one["ci95"] or (math.nan, math.nan)
        print(
            f"{'':>12}{who}: deformation {one['deformation']:.3f}, closeness {one['closeness']:.3f}, failed "
            f"{one['failed']:.1%}, {one['difference']:+.4f} m [{low:+.4f}, {high:+.4f}]",
            flush=True,
        )


def _steps(rows: Sequence[dict[str, Any]], what: str) -> dict[str, Any]:
    """Return how each car differs from the next, and how far the first is from the last.

    Differences are of attempts on the same φ with the same number, whose draws are the same; intervals are normal ones
    over such pairs, and Student's over φ.
    """
    steps = []
    for one, other in itertools.pairwise(rows):
        common = sorted(one[what].keys() & other[what].keys())
        differences = np.array([other[what][number] - one[what][number] for number in common])
        of_phi = np.array([split_episode_id(number)[1] for number in common])
        by_phi = clustered_mean([differences[of_phi == index] for index in np.unique(of_phi)])
        steps.append(
            {
                "from": one["multiplier"],
                "to": other["multiplier"],
                "pairs": len(common),
                "difference": float(differences.mean()),
                "ci95_pairs": normal_interval(differences),
                "ci95": by_phi.interval if by_phi else None,
            }
        )
    first, last = (np.array(list(row[what].values())) for row in (rows[0], rows[-1]))
    pooled = math.sqrt(0.5 * (first.var(ddof=1) + last.var(ddof=1)))
    return {"steps": steps, "cohens_d": float(last.mean() - first.mean()) / pooled if pooled else None}


def _show_steps(what: str, found: dict[str, Any]) -> None:
    print(f"{what}: each car less the one before it, in pairs")
    for step in found["steps"]:
        low, high = step["ci95_pairs"] or (math.nan, math.nan)
        clustered = step["ci95"] or (math.nan, math.nan)
        told = "rises" if low > 0.0 else "falls" if high < 0.0 else "not told apart"
        print(
            f"  C {step['from']:g} to {step['to']:g}: {step['difference']:+.4f} m [{low:+.4f}, {high:+.4f}], "
            f"by φ [{clustered[0]:+.4f}, {clustered[1]:+.4f}], {step['pairs']} pairs: {told}"
        )
    if found["cohens_d"] is not None:
        print(f"  Cohen's d of the last against the first: {found['cohens_d']:.2f}")


def main() -> None:
    """Measure, and print lines or JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--controller", default="basic", metavar="NAME")
    parser.add_argument("--scenario", metavar="NAME|FILE")
    parser.add_argument("--multipliers", type=float, nargs="+", default=list(PAPER_MULTIPLIERS), metavar="C")
    parser.add_argument("--safe", default=SYNTHETIC, metavar="PATH", help="recorded safe trajectories")
    parser.add_argument("--safe-count", type=int, default=5, metavar="N")
    parser.add_argument("--episodes", type=int, default=100, metavar="N", help="attempts on each φ (default 100)")
    parser.add_argument("--budgets", type=int, nargs="*", default=[], metavar="N", help="of the search for any car")
    parser.add_argument(
        "--informed", type=int, nargs="*", default=[], metavar="N", help="simulations of kamikazes told the car's state"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    parser.add_argument("--workers", type=int, default=available_workers(), metavar="N")
    parser.add_argument("--json", action="store_true", help="print JSON")
    arguments = parser.parse_args()
    if arguments.informed and arguments.controller != "basic":
        parser.error("--informed needs the basic controller, whose car is known")
    plan = Plan(
        scenario_for(arguments.scenario, arguments.safe),
        controller=arguments.controller,
        safe=arguments.safe,
        safe_count=arguments.safe_count,
        kamikaze_count=arguments.episodes,
        collision_runs=1,
        seed=arguments.seed,
        objective=Objective.DEFORMATION,
    )
    warm_up_margins()
    rows = []
    for multiplier in arguments.multipliers if arguments.controller == "basic" else [1.0]:
        with InProcessRunner(arguments.workers) as runner:
            rows.append(_row(replace(plan, multiplier=multiplier), arguments.budgets, arguments.informed, runner))
        if not arguments.json:
            _show(rows[-1])
    ratios = [row["closeness"] for row in rows if row["closeness"] is not None]
    names = rows[0]["informed"]
    means = {who: float(np.mean([row["informed"][who]["closeness"] for row in rows])) for who in names}
    paired = {what: _steps(rows, what) for what in ("attempts", "margins") if len(rows) > 1 and rows[0][what]}
    summary = {
        "rows": rows,
        "paired": paired,
        "mean_closeness": float(np.mean(ratios)) if ratios else None,
        "mean_closeness_informed": means,
    }
    if arguments.json:
        print(json.dumps(summary, indent=2))
    elif ratios:
        print(f"mean closeness {summary['mean_closeness']:.3f}")
        for who, closeness in means.items():
            print(f"mean closeness {closeness:.3f}: {who}")
    if not arguments.json:
        for what, found in paired.items():
            _show_steps({"attempts": "deformation", "margins": "margin"}[what], found)


if __name__ == "__main__":
    main()
