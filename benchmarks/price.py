"""What caution costs cars of which it is known, and how often the intervals of that hold.

    python benchmarks/price.py [--safe synthetic|FOLDER] [--scenario NAME] [--repetitions 1] [--count 60]

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
from skd_evaluator.metrics.price_of_caution import PriceOfCaution
from skd_evaluator.metrics.statistics import mean

EXAMPLES = "examples/price_of_caution/cars.py"
CARS = ("NeverBrakes", "BrakesByTimeToCollision", "HalfSpeed", "StopsAndWaits", "BrakesForEverybody")
MULTIPLIERS = (0.5, 0.75, 1.0, 1.5)


def prices(plan: Plan, repetitions: int, count: int) -> list[PriceOfCaution]:
    """Return the price of a car with each of some seeds."""
    found = []
    with InProcessRunner(1) as runner:
        runner.start([])
        for seed in range(plan.seed, plan.seed + repetitions):
            one = replace(plan, seed=seed)
            found.append(price_of_caution(one, safe_trajectories(one, runner), runner, count))
    return [one for one in found if one is not None]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--safe", default="synthetic")
    parser.add_argument("--scenario")
    parser.add_argument("--repetitions", type=int, default=1, metavar="N")
    parser.add_argument("--count", type=int, default=RUNS, metavar="N")
    arguments = parser.parse_args()
    scenario = scenario_for(arguments.scenario, arguments.safe)
    plan = Plan(scenario, safe=arguments.safe, safe_count=20)
    cars = [replace(plan, controller=f"{EXAMPLES}:{name}") for name in CARS]
    cars += [replace(plan, multiplier=multiplier) for multiplier in MULTIPLIERS]
    print("| car | time lost (s) | slow (s) | needless | deadlock | held |\n|---|---|---|---|---|---|")
    for car in cars:
        found = prices(car, arguments.repetitions, arguments.count)
        lost, slow, needless, deadlock = (
            mean([getattr(one, name) for one in found]) for name in ("time_lost", "slow", "needless", "deadlock")
        )
        ends = [one.time_lost_ci95 or (lost, lost) for one in found]
        held = sum(low <= lost <= high for low, high in ends) / len(found)
        name = car.controller.rpartition(":")[2] if ":" in car.controller else f"basic, C = {car.multiplier:g}"
        low, high = ends[0]
        around = f"{lost:.2f} [{low:.2f}, {high:.2f}]" if len(found) == 1 else f"{lost:.2f}"
        said = f"{held:.0%}" if len(found) > 1 else "–"
        print(f"| {name} | {around} | {slow:.2f} | {needless:.0%} | {deadlock:.0%} | {said} |", flush=True)


if __name__ == "__main__":
    main()
