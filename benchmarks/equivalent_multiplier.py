"""Whether the interval of the equivalent multiplier holds the truth as often as it says.

The basic car is rated by a sweep of itself that does not contain its C: the equivalent multiplier has to be that C.
Many campaigns, each with draws of its own for car and sweep; within one, attempts of one number share their draws, as
in `skd assess` with the sweep that comes along. The planner's budget is small, for what is tested is the interval.

    python benchmarks/equivalent_multiplier.py [--repetitions 200] [--kamikaze-count 20] [--simulations 100] [--json]
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from typing import Any

import numpy as np
from skd_adversary.warm_up import warm_up_episodes
from skd_evaluator.campaign.assessment import assess
from skd_evaluator.campaign.plan import Plan, safe_trajectories
from skd_evaluator.campaign.reference_sweep import reference_from
from skd_evaluator.campaign.workers import InProcessRunner, available_workers
from skd_evaluator.cli.sweep import DENSE
from skd_evaluator.measure.statistics import wilson_interval
from skd_sim.encounter.scenario import load_scenario
from skd_sim.objective import Objective
from skd_sim.trajectory import Trajectory

CARS = (0.8, 0.95, 1.08, 1.3)
NEIGHBOURS = 3
SWEEP = sorted(
    {DENSE[0], DENSE[-1]}
    | {one for car in CARS for one in sorted(DENSE, key=lambda one: abs(one - car))[: 2 * NEIGHBOURS]}
)
"""Of the sweep that comes along, the C beside those of the cars: who is far away has no say in what is read off."""


def campaign(task: tuple[Plan, list[Trajectory]]) -> list[tuple[float, float, float]]:
    """Run one campaign, and return value and interval of each car; ends beyond the sweep are infinite."""
    plan, safe = task
    runner = InProcessRunner(1)
    silent = lambda *_: None  # noqa: E731
    done = {one: assess(replace(plan, multiplier=one), safe, runner, silent) for one in (*SWEEP, *CARS)}
    reference = reference_from([done[one] for one in SWEEP])
    found = []
    for one in CARS:
        rated = reference.equivalent(done[one])
        assert rated is not None
        found.append((rated.value, *rated.ci95))
    return found


def main() -> None:
    """Measure, and print a table or JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repetitions", type=int, default=200, metavar="N")
    parser.add_argument("--kamikaze-count", type=int, default=20, metavar="N", help="per φ (default 20)")
    parser.add_argument("--simulations", type=int, default=100, metavar="N", help="per decision (default 100)")
    parser.add_argument("--workers", type=int, default=available_workers(), metavar="N")
    parser.add_argument("--json", action="store_true", help="print JSON")
    arguments = parser.parse_args()
    plan = Plan(
        load_scenario("crossing"),
        kamikaze_count=arguments.kamikaze_count,
        collision_runs=1,
        simulations=arguments.simulations,
        objective=Objective.DEFORMATION,
    )
    with InProcessRunner(arguments.workers, isolated=True) as runner:
        runner.start(warm_up_episodes(objective=Objective.DEFORMATION))
        safe = safe_trajectories(plan, runner)
        tasks = [(replace(plan, seed=1000 + repetition), safe) for repetition in range(arguments.repetitions)]
        done = []
        for count, one in enumerate(runner.map(campaign, tasks), start=1):
            done.append(one)
            held = sum(low <= car <= high for each in done for car, (_, low, high) in zip(CARS, each, strict=True))
            print(f"{count} campaigns: {held} of {count * len(CARS)} intervals hold C", file=sys.stderr, flush=True)
    found = np.array(done)  # repetitions × cars × (value, low, high)
    rows: list[dict[str, Any]] = []
    for index, truth in enumerate(CARS):
        value, low, high = found[:, index].T
        held = int(((low <= truth) & (truth <= high)).sum())
        rows.append(
            {
                "multiplier": truth,
                "mean": float(value.mean()),
                "standard_deviation": float(value.std(ddof=1)),
                "mean_width": float((high - low).mean()),
                "held": held / len(found),
                "held_ci95": wilson_interval(held, len(found)),
            }
        )
    held = sum(round(row["held"] * len(found)) for row in rows)
    over_all = {"held": held / found.shape[0] / len(CARS), "repetitions": len(found)}
    if arguments.json:
        print(json.dumps({"rows": rows, **over_all}, indent=2))
        return
    print("| C | mean | standard deviation | mean width of the interval | holds C |")
    print("|---|---|---|---|---|")
    for row in rows:
        print(
            f"| {row['multiplier']:g} | {row['mean']:.3f} | {row['standard_deviation']:.3f} | {row['mean_width']:.3f} "
            f"| {100 * row['held']:.1f} % [{100 * row['held_ci95'][0]:.1f}, {100 * row['held_ci95'][1]:.1f}] |"
        )
    print(f"over all: {100 * over_all['held']:.1f} % of {len(found)} campaigns × {len(CARS)} cars")


if __name__ == "__main__":
    main()
