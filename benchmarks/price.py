"""What caution costs cars of which it is known, and how often the intervals of that hold.

    python benchmarks/price.py [--safe synthetic|FOLDER] [--scenario NAME] [--repetitions 1]

With --repetitions each car is rated with so many seeds. The figures are then the means over all, and `held` is the
share of the intervals of time lost that hold its mean.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

from skd_evaluator.assessment.from_options import scenario_for
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.price import RUNS, price_of_caution
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.metrics.statistics import mean

EXAMPLES = "examples/price_of_caution/cars.py"
CARS = ("NeverBrakes", "BrakesByTimeToCollision", "HalfSpeed", "StopsAndWaits", "BrakesForEverybody")
MULTIPLIERS = (0.5, 0.75, 1.0, 1.5)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--safe", default="synthetic")
    parser.add_argument("--scenario")
    parser.add_argument("--repetitions", type=int, default=1, metavar="N")
    arguments = parser.parse_args()
    plan = Plan(scenario_for(arguments.scenario, arguments.safe), safe=arguments.safe, safe_count=20)
    cars = {name: replace(plan, controller=f"{EXAMPLES}:{name}") for name in CARS}
    cars |= {f"basic, C = {one:g}": replace(plan, multiplier=one) for one in MULTIPLIERS}
    print("| car | time lost (s) | 95 % | slow (s) | needless | deadlock | held |\n|---|---|---|---|---|---|---|")
    with InProcessRunner(1) as runner:
        runner.start([])
        for name, car in cars.items():
            plans = [replace(car, seed=seed) for seed in range(arguments.repetitions)]
            every = (price_of_caution(one, safe_trajectories(one, runner), runner, RUNS) for one in plans)
            found = [one for one in every if one is not None]
            keys = ("time_lost", "slow", "needless", "deadlock")
            lost, slow, needless, deadlock = (mean([one.mean(key) for one in found]) for key in keys)
            ends = [one.ci95("time_lost") or (lost, lost) for one in found]
            held = sum(low <= lost <= high for low, high in ends) / len(found)
            shown = "[{:.2f}, {:.2f}]".format(*ends[0]) if len(found) == 1 else "–"
            cells = f"{lost:.2f} | {shown} | {slow:.2f} | {needless:.0%} | {deadlock:.0%} | {held:.0%}"
            print(f"| {name} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
