"""How much the margin of the basic car varies between and within φ: as `skd compare --width` assumes it.

    .venv/bin/python benchmarks/margin_variances.py --safe-count 200 --kamikaze-count 25

Exact margins at C = 1 and 1.05 on the same synthetic φ and draws; of the first car, and of the difference of trials
of one number, the standard deviation between φ and within, and what the first is at most, with 95 % (the mean square
between φ is taken for a multiple of χ²).
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from scipy import stats
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.margin import exact_margins, warm_up_margins
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.metrics.clustered import variance_components
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.state import FloatArray, Trajectory

CARS = (1.0, 1.05)


def margins(plan: Plan, safe: list[Trajectory], runner: InProcessRunner) -> FloatArray:
    """Return the margin of each trial, φ × trials, m."""
    episodes = plan.trials(safe, plan.kamikaze_count)
    eta_max = plan.scenario.eta_max
    ways = exact_margins(episodes, runner, lambda *_told: None)
    found = [eta_max if way is None else min(way.distance, eta_max) for way in ways]
    return np.array(found).reshape(len(safe), plan.kamikaze_count)


def greatest_between(groups: FloatArray) -> float:
    """Return what the standard deviation between φ is at most, with 95 %, m."""
    count, size = groups.shape
    mean_square = size * groups.mean(axis=1).var(ddof=1)
    within = groups.var(axis=1, ddof=1).mean()
    most = mean_square * (count - 1) / stats.chi2.ppf(0.05, count - 1)
    return float(np.sqrt(max(0.0, most - within) / size))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--safe-count", type=int, default=200, metavar="N")
    parser.add_argument("--kamikaze-count", type=int, default=25, metavar="N")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    parser.add_argument("--workers", type=int, default=1, metavar="N")
    arguments = parser.parse_args()
    plan = Plan(
        load_scenario("crossing"),
        seed=arguments.seed,
        safe_count=arguments.safe_count,
        kamikaze_count=arguments.kamikaze_count,
    )
    with InProcessRunner(arguments.workers) as runner:
        warm_up_margins()
        safe = list(safe_trajectories(plan, runner))
        first, second = (margins(replace(plan, multiplier=multiplier), safe, runner) for multiplier in CARS)
    print("| of | mean (m) | between φ (m) | at most (m) | within (m) |")
    print("|---|---|---|---|---|")
    for name, groups in ((f"C = {CARS[0]:g}", first), (f"C = {CARS[1]:g} less it", second - first)):
        found = variance_components(list(groups))
        assert found.between is not None
        assert found.within is not None
        most = greatest_between(groups)
        print(f"| {name} | {groups.mean():.3f} | {found.between**0.5:.3f} | {most:.3f} | {found.within**0.5:.3f} |")


if __name__ == "__main__":
    main()
