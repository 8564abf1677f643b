"""How often `skd compare` finds a difference where there is none, and where there is one.

    .venv/bin/python benchmarks/comparison.py --better 50 --out comparison.npz

Campaigns of the default size, three a repetition: the basic car at C = 1 with two seeds, and at C = 1.05 with the first
of them; the last in the first `--better` repetitions alone. Their exact margins, or with `--figure deviation` what
kamikazes of that objective come to, are held against each other, as `skd compare` does:

* C = 1 with itself on the other seed, so on other φ: a difference should be found in 5 of 100;
* C = 1 with itself on the same φ with other draws (the first half of the trials with the second): likewise;
* C = 1 with C = 1.05 on the same φ and draws: it should be found; and on other φ, what is lost by that.

Last it says how often the interval by φ of one campaign of C = 1 holds the mean over all campaigns of it, each of φ of
its own: coverage without any resampling.

What was run is kept in --out, and a second start goes on where the first one stopped.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from margin_variances import margins
from skd_evaluator.assessment.assessment import KamikazeSet
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.kamikazes import kamikaze_sets
from skd_evaluator.assessment.stages.margin import warm_up_margins
from skd_evaluator.assessment.stages.pipeline import planners_of
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.metrics.clustered import DISTANCES, clustered_mean
from skd_evaluator.metrics.deviation import deviation
from skd_evaluator.metrics.difference import Difference, difference
from skd_evaluator.metrics.statistics import wilson_interval
from skd_sim.options.car_and_adversary import Objective
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.state import FloatArray

FIRST_SEED = 1000
CARS = ((1.0, 0), (1.0, 1), (1.05, 0))
"""C, and which of the repetition's two seeds."""
ALL_PAIRS = "C = 1 with itself, all pairs of seeds"


def campaign(multiplier: float, seed: int, asked: Plan, figure: str, runner: InProcessRunner) -> FloatArray:
    """Return what each trial of a campaign counts as, φ × trials, m.

    Kamikazes beyond the wanted number, after failures, are left out, so that all φ have as many.
    """
    plan = replace(asked, multiplier=multiplier, seed=seed)
    safe = list(safe_trajectories(plan, runner))
    if figure == "margin":
        return margins(plan, safe, runner)
    return np.array([trials(group, plan)[: plan.kamikaze_count] for group in kamikaze_sets(plan, safe, runner)])


def trials(group: KamikazeSet, plan: Plan) -> list[float]:
    """Return what each trial on φ counts as, in the order of their numbers, m."""
    found = []
    for log in group.finished:
        needed = plan.scenario.eta_max
        if log.hit:
            ticks = log.impact_time / plan.scenario.time_step
            needed = min(needed, deviation(group.safe_trajectory.positions, log.trajectory.positions, ticks))
        found.append(needed)
    return found


def comparisons(first: FloatArray, other: FloatArray, better: FloatArray | None) -> dict[str, Difference]:
    """Return the comparisons of one repetition."""
    half = first.shape[1] // 2
    found = {
        "C = 1 with itself, other seed": difference(list(first), list(other), paired=False),
        "C = 1 with itself, same φ, other draws": difference(list(first[:, :half]), list(first[:, half:]), paired=True),
    }
    if better is not None:
        found["C = 1 with C = 1.05, same seed"] = difference(list(first), list(better), paired=True)
        found["C = 1 with C = 1.05, other seed"] = difference(list(other), list(better), paired=False)
    return {name: one for name, one in found.items() if one is not None}


def summary(runs: Mapping[str, FloatArray], repetitions: int) -> dict[str, list[Difference]]:
    """Return the comparisons of all repetitions, and of any two campaigns of C = 1: these pairs share campaigns."""
    rows: dict[str, list[Difference]] = {}
    for number in range(repetitions):
        first, other = (runs[key(car, number)] for car in CARS[:2])
        for name, one in comparisons(first, other, runs.get(key(CARS[2], number))).items():
            rows.setdefault(name, []).append(one)
    # With as many trials on each φ their means say all.
    means = [
        list(runs[key(car, number)].mean(axis=1, keepdims=True)) for number in range(repetitions) for car in CARS[:2]
    ]
    pairs = [difference(*pair, paired=False) for pair in itertools.combinations(means, 2)]
    rows[ALL_PAIRS] = [one for one in pairs if one is not None and one.interval is not None]
    return rows


def held(runs: Mapping[str, FloatArray], repetitions: int) -> dict[str, tuple[int, int]]:
    """Return how many campaigns of C = 1 have an interval that holds the mean over all of them, and of how many."""
    campaigns = [list(runs[key(car, number)]) for number in range(repetitions) for car in CARS[:2]]
    truth = float(np.mean([group.mean() for campaign in campaigns for group in campaign]))
    found = {}
    for name, prior in (("by φ", DISTANCES), ("Student's t", None)):
        ends = [one.interval for one in (clustered_mean(groups, prior=prior) for groups in campaigns) if one]
        found[name] = (sum(low <= truth <= high for low, high in filter(None, ends)), len(ends))
    return found


def key(car: tuple[float, int], number: int) -> str:
    """Return the name of a campaign in --out."""
    return f"{car[0]:g}_{FIRST_SEED + 2 * number + car[1]}"


def main() -> None:
    """Run what is missing and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repetitions", type=int, default=200, metavar="N")
    parser.add_argument("--better", type=int, metavar="N", help="repetitions of C = 1.05; all by default")
    parser.add_argument("--figure", choices=("margin", "deviation"), default="margin")
    parser.add_argument("--safe-count", type=int, default=Plan.safe_count, metavar="N")
    parser.add_argument("--kamikaze-count", type=int, default=Plan.kamikaze_count, metavar="N")
    parser.add_argument("--workers", type=int, default=1, metavar="N")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="npz file of what was run")
    arguments = parser.parse_args()
    runs: dict[str, FloatArray] = {}
    if arguments.out.exists():
        with np.load(arguments.out) as stored:
            runs = {name: stored[name] for name in stored.files}
    begin = time.perf_counter()
    with InProcessRunner(arguments.workers) as runner:
        plan = Plan(
            load_scenario("crossing"),
            objective=Objective.DEVIATION,
            safe_count=arguments.safe_count,
            kamikaze_count=arguments.kamikaze_count,
        )
        warm_up_margins()
        runner.start(planners_of(plan, [Objective.DEVIATION]))
        better = arguments.repetitions if arguments.better is None else min(arguments.better, arguments.repetitions)
        # C = 1.05 at last: what is found by chance alone takes the most repetitions.
        wanted = [(car, number) for number in range(arguments.repetitions) for car in CARS[:2]]
        wanted += [(CARS[2], number) for number in range(better)]
        missing = [one for one in wanted if key(*one) not in runs]
        for done, (car, number) in enumerate(missing, start=1):
            runs[key(car, number)] = campaign(car[0], FIRST_SEED + 2 * number + car[1], plan, arguments.figure, runner)
            if done % 10 == 0 or done == len(missing):
                partial = arguments.out.with_name(f"{arguments.out.name}.tmp.npz")
                np.savez_compressed(partial, **runs)  # type: ignore[arg-type]
                partial.replace(arguments.out)
                print(f"{done} of {len(missing)} campaigns, {time.perf_counter() - begin:.0f} s", flush=True)
    print("| compared | pairs | difference (m) | width of the interval (m) | found | 95 % | second car called safer |")
    print("|---|---|---|---|---|---|---|")
    for name, row in summary(runs, arguments.repetitions).items():
        count, different = len(row), sum(one.direction != 0 for one in row)
        safer = sum(one.direction > 0 for one in row)
        interval = None if name == ALL_PAIRS else wilson_interval(different, count)
        ends = "–" if interval is None else f"[{100 * interval[0]:.1f}, {100 * interval[1]:.1f}]"
        width = np.mean([one.interval[1] - one.interval[0] for one in row if one.interval])
        print(
            f"| {name} | {count} | {np.mean([one.value for one in row]):+.3f} | {width:.3f} "
            f"| {100 * different / count:.1f} % | {ends} | {100 * safer / count:.1f} % |"
        )
    for name, (count, campaigns) in held(runs, arguments.repetitions).items():
        low, high = wilson_interval(count, campaigns) or (0.0, 1.0)
        share = f"{100 * count / campaigns:.1f} %, 95 % [{100 * low:.1f}, {100 * high:.1f}]"
        of = f"{campaigns} campaigns of C = 1 hold the mean of all"
        print(f"intervals of the {arguments.figure}, {name}: {share} of {of}")


if __name__ == "__main__":
    main()
