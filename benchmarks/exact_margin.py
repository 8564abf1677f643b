"""What the exact margin of the basic car costs and gives: mean, largest gap, core seconds.

Per C: the mean margin of trials, each at most η_max; the largest gap (m, and as a share of its margin), how many
margins have one, how many trials have no hit within η_max, core seconds in sum and the milliseconds of the slowest.

    python benchmarks/exact_margin.py [--safe DIR] [--safe-count 20] [--trials 25] [--multipliers C ...] [--json]
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from skd_evaluator.assessment.from_options import scenario_for
from skd_evaluator.assessment.options import SYNTHETIC
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.margin import warm_up_margins
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.margin.exact.exact import exact_margin
from skd_sim.world.episode import Mode
from skd_sim.world.state import Trajectory

MULTIPLIERS = (0.5, 0.625, 0.75, 0.875, 1.0, 1.05, 1.1, 1.125, 1.15, 1.3, 1.5)


def row(plan: Plan, safe: Sequence[Trajectory], trials: int) -> dict[str, Any]:
    """Return the figures of one C."""
    episodes = [
        plan.episode(Mode.KAMIKAZE, index, trial, phi) for index, phi in enumerate(safe) for trial in range(trials)
    ]
    eta_max = plan.scenario.eta_max
    margins, gaps, seconds = np.full(len(episodes), eta_max), np.zeros(len(episodes)), np.empty(len(episodes))
    none = 0
    for index, episode in enumerate(episodes):
        begin = time.process_time()
        found = exact_margin(episode)
        seconds[index] = time.process_time() - begin
        if found is None:
            none += 1
        else:
            margins[index], gaps[index] = found.distance, found.gap
    return {
        "multiplier": plan.multiplier,
        "trials": len(episodes),
        "margin": float(margins.mean()),
        "gap": float(gaps.max()),
        "gap_share": float(np.max(np.divide(gaps, margins, out=np.zeros_like(gaps), where=margins > 0.0))),
        "inexact": int((gaps > 0.0).sum()),
        "none": none,
        "seconds": float(seconds.sum()),
        "slowest_ms": 1e3 * float(seconds.max()),
    }


def main() -> None:
    """Print a line for each C."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--safe", default=SYNTHETIC, help="folder of recorded trajectories")
    parser.add_argument("--safe-count", type=int, default=20)
    parser.add_argument("--trials", type=int, default=25, help="on each φ")
    parser.add_argument("--multipliers", type=float, nargs="+", default=MULTIPLIERS)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    warm_up_margins()
    scenario = scenario_for(None, options.safe)
    base = Plan(scenario, safe=options.safe, safe_count=options.safe_count)
    safe = safe_trajectories(base, InProcessRunner())
    rows = []
    for multiplier in options.multipliers:
        plan = Plan(scenario, safe=options.safe, safe_count=options.safe_count, multiplier=multiplier)
        rows.append(row(plan, safe, options.trials))
        if not options.json:
            one = rows[-1]
            print(
                f"C {multiplier:5.3f}: margin {one['margin']:.4f} m,"
                f" largest gap {one['gap']:.4f} m ({100.0 * one['gap_share']:.1f} %), not exact {one['inexact']},"
                f" none {one['none']} of {one['trials']}, {one['seconds']:.2f} s, slowest {one['slowest_ms']:.0f} ms",
                flush=True,
            )
    if options.json:
        print(json.dumps(rows, indent=2))


if __name__ == "__main__":
    main()
