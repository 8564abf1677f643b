"""How near kamikazes of objective deformation come to the clairvoyant one, and the search for any car to the floor.

Per car: the mean deformation over all attempts (a failed one counts as η_max), that of the attempts that collided, the
floor of their episodes, closeness = the ratio of the two, the floor over all attempts, and milliseconds that an exact
floor takes. With --budgets also what the search that knows nothing of the car finds in the same episodes (failed
attempts included), over the exact floor, and how long it takes. With --controller another car than the basic one: then
only what that search finds is known.

    python benchmarks/deformation_closeness.py [--safe DIR] [--safe-count N] [--episodes N] [--budgets N ...] [--json]
    python benchmarks/deformation_closeness.py --controller cal --budgets 250 1000
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from skd_evaluator.anytime_floor import actions_of, anytime_floor
from skd_evaluator.assessment import Assessment, assess
from skd_evaluator.campaign import SYNTHETIC, Plan, safe_trajectories
from skd_evaluator.clairvoyant_deformation import deformation_floor
from skd_evaluator.floor import foretold, warm_up_floor, with_floor
from skd_evaluator.tasks import planners_of, scenario_for
from skd_evaluator.workers import InProcessRunner, available_workers
from skd_sim.controllers import PAPER_MULTIPLIERS
from skd_sim.episode import EpisodeLog
from skd_sim.objective import Objective


def _silent(_label: str, _done: int, _total: int) -> None:
    pass


def _tried(assessment: Assessment) -> list[EpisodeLog]:
    return [log for group in assessment.kamikaze for log in (*group.logs, *group.misses)]


def _exact(log: EpisodeLog) -> tuple[float, float, float]:
    """Return exact floor (η_max where there is none below), its gap, both in m, and the seconds that it took."""
    eta_max = log.episode.scenario.eta_max
    begin = time.perf_counter()
    found = deformation_floor(log.episode, eta_max)
    seconds = time.perf_counter() - begin
    return (eta_max, 0.0, seconds) if found is None else (found.distance, found.gap, seconds)


def _search(job: tuple[EpisodeLog, int, bool]) -> tuple[float, float]:
    """Return what the search finds (η_max where that is less), m, and the seconds that it took."""
    log, budget, with_start = job
    begin = time.perf_counter()
    found = anytime_floor(log.episode, budget, actions_of(log) if with_start else None)
    eta_max = log.episode.scenario.eta_max
    return eta_max if found is None else min(found.distance, eta_max), time.perf_counter() - begin


def _row(plan: Plan, budgets: Sequence[int], runner: InProcessRunner) -> dict[str, Any]:
    safe = safe_trajectories(plan, runner)
    runner.start(planners_of(plan, [Objective.DEFORMATION]))
    assessment = assess(plan, safe, runner, _silent)
    known = foretold(plan.controller, plan.scenario)
    if known:
        assessment = with_floor(assessment, runner, _silent)
    row: dict[str, Any] = {"controller": plan.controller, "multiplier": plan.multiplier, **assessment.figures()}
    tried = _tried(assessment)
    exact = np.array(list(runner.map(_exact, tried))) if known else np.full((len(tried), 3), np.nan)
    row["floor_ms"], row["floor_ms_worst"] = 1e3 * float(exact[:, 2].mean()), 1e3 * float(exact[:, 2].max())
    row["floor_gap_mean"], row["floor_gap_worst"] = float(exact[:, 1].mean()), float(exact[:, 1].max())
    row["searches"] = {}
    for budget in budgets:
        for with_start in (False, True):
            found = np.array(list(runner.map(_search, [(log, budget, with_start) for log in tried])))
            row["searches"][f"{budget}{' from the kamikaze' if with_start else ''}"] = {
                "mean": float(found[:, 0].mean()),
                "over_exact": float(found[:, 0].mean() / exact[:, 0].mean()) if known else None,
                "ms": 1e3 * float(found[:, 1].mean()),
            }
    return row


def _show(row: dict[str, Any]) -> None:
    name = f"C = {row['multiplier']:g}" if row["controller"] == "basic" else row["controller"]

    def number(value: float | None, digits: int = 3) -> str:
        return "-" if value is None else f"{value:.{digits}f}"

    figures = (
        f"{name:>10}: success {row['success_rate']:6.1%}",
        f"deformation {number(row['deformation'])}",
        f"of successes {number(row['deformation_of_successes'])}",
        f"floor {number(row['floor'])}",
        f"closeness {number(row['closeness'])}",
        f"floor of all {number(row['floor_of_all'])}",
        f"exact floor {row['floor_ms']:.1f} ms (worst {row['floor_ms_worst']:.0f})",
        f"gap {row['floor_gap_mean']:.4f} m (worst {row['floor_gap_worst']:.3f})",
    )
    print(", ".join(figures), flush=True)
    for budget, one in row["searches"].items():
        print(
            f"{'':>12}budget {budget}: {one['mean']:.3f} m, over exact {number(one['over_exact'])}, {one['ms']:.0f} ms"
        )


def main() -> None:
    """Measure, and print lines or JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--controller", default="basic", metavar="NAME")
    parser.add_argument("--scenario", metavar="NAME|FILE")
    parser.add_argument("--multipliers", type=float, nargs="+", default=list(PAPER_MULTIPLIERS), metavar="C")
    parser.add_argument("--safe", default=SYNTHETIC, metavar="PATH", help="recorded safe trajectories")
    parser.add_argument("--safe-count", type=int, default=5, metavar="N")
    parser.add_argument("--episodes", type=int, default=100, metavar="N", help="wanted collisions per φ (default 100)")
    parser.add_argument("--budgets", type=int, nargs="*", default=[], metavar="N", help="of the search for any car")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    parser.add_argument("--workers", type=int, default=available_workers(), metavar="N")
    parser.add_argument("--json", action="store_true", help="print JSON")
    arguments = parser.parse_args()
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
    warm_up_floor()
    rows = []
    for multiplier in arguments.multipliers if arguments.controller == "basic" else [1.0]:
        with InProcessRunner(arguments.workers) as runner:
            rows.append(_row(replace(plan, multiplier=multiplier), arguments.budgets, runner))
        if not arguments.json:
            _show(rows[-1])
    ratios = [row["closeness"] for row in rows if row["closeness"] is not None]
    summary = {"rows": rows, "mean_closeness": float(np.mean(ratios)) if ratios else None}
    if arguments.json:
        print(json.dumps(summary, indent=2))
    elif ratios:
        print(f"mean closeness {summary['mean_closeness']:.3f}")


if __name__ == "__main__":
    main()
