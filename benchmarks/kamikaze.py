"""How fast kamikaze pairs are made: plan, simulate, compare; both objectives, synthetic φ, the default budget.

Everything is compiled before the clock starts. `planning` is the tree search; the rest is belief, world and car. Time
of a pair is processor time; that of a campaign is the wall clock's, one worker and two in turns, without their start.

    python benchmarks/kamikaze.py [--episodes N] [--pairs N]
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from skd_adversary.adversary import warm_up_episodes
from skd_adversary.pomdp.planner import Planner
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.kamikazes import kamikaze_sets
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.metrics.frechet import discrete_frechet
from skd_evaluator.metrics.skd import compute_skd
from skd_sim.options.car_and_adversary import Objective
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.episode import Mode, Outcome
from skd_sim.world.state import Trajectory

_MULTIPLIERS = (0.5, 1.0, 1.15)
_SAFE_COUNT = 5
_TURNS = 3


class _Clock:
    """Adds up the time and the number of planning decisions."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self.decisions = 0


@contextmanager
def _timed_planner() -> Iterator[_Clock]:
    clock, plan = _Clock(), Planner.plan

    def timed(self: Planner, belief: object) -> int:
        begin = time.process_time()
        action = plan(self, belief)  # type: ignore[arg-type]
        clock.seconds += time.process_time() - begin
        clock.decisions += 1
        return action

    Planner.plan = timed  # type: ignore[method-assign]
    try:
        yield clock
    finally:
        Planner.plan = plan  # type: ignore[method-assign]


def _pairs(plan: Plan, safe: list[Trajectory], count: int) -> dict[str, Any]:
    """Make pairs one by one in this process."""
    episodes = [
        plan.episode(Mode.KAMIKAZE, number % len(safe), number // len(safe), safe[number % len(safe)])
        for number in range(count)
    ]
    for number, episode in enumerate(episodes[: len(safe)]):
        discrete_frechet(safe[number].positions, run_episode(episode).trajectory.positions)
    with _timed_planner() as clock:
        begin = time.process_time()
        logs = [run_episode(episode) for episode in episodes]
        distances = [
            discrete_frechet(safe[number % len(safe)].positions, log.trajectory.positions)
            for number, log in enumerate(logs)
        ]
        seconds = time.process_time() - begin
    return {
        "objective": str(plan.objective),
        "multiplier": plan.multiplier,
        "ms_per_pair": 1000.0 * seconds / count,
        "decisions_per_pair": clock.decisions / count,
        "planning_share": clock.seconds / seconds,
        "success_rate": sum(log.outcome == Outcome.COLLISION for log in logs) / count,
        "mean_distance": statistics.fmean(distances),
    }


def _campaign(plan: Plan, safe: list[Trajectory], workers: int) -> float:
    """Return the seconds that the pairs of a whole campaign take, their SKD included."""
    with InProcessRunner(workers) as runner:
        runner.start()
        list(runner.map(abs, [0] * workers))
        begin = time.perf_counter()
        sets = kamikaze_sets(plan, safe, runner)
        compute_skd([(group.safe_trajectory, [log.trajectory for log in group.logs]) for group in sets])
        return time.perf_counter() - begin


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=200, metavar="N", help="per car and objective (default 200)")
    parser.add_argument("--pairs", type=int, default=500, metavar="N", help="of the campaign (default 500)")
    arguments = parser.parse_args()
    if arguments.episodes < 1 or arguments.pairs < _SAFE_COUNT:
        parser.error(f"--episodes must be at least 1 and --pairs at least {_SAFE_COUNT}")
    plan = Plan(load_scenario("crossing"), safe_count=_SAFE_COUNT, kamikaze_count=arguments.pairs // _SAFE_COUNT)
    runner = InProcessRunner(1)
    for objective in Objective:
        runner.start(warm_up_episodes(objective=objective))
    safe = safe_trajectories(plan, runner)
    rows = [
        _pairs(replace(plan, multiplier=value, objective=objective), safe, arguments.episodes)
        for objective in Objective
        for value in _MULTIPLIERS
    ]
    campaigns = []
    for objective in Objective:
        own = replace(plan, objective=objective)
        turns = [(_campaign(own, safe, 1), _campaign(own, safe, 2)) for _ in range(_TURNS)]
        one, two = (statistics.median(times) for times in zip(*turns, strict=True))
        ratio = statistics.median(first / second for first, second in turns)
        campaigns.append({"objective": str(objective), "one_worker": one, "two_workers": two, "ratio": ratio})
    print(f"Kamikaze pairs of the basic car on one core, {plan.simulations} simulations per decision")
    print(f"{'objective':>10}{'C':>7}{'ms/pair':>9}{'decisions':>11}{'planning':>10}{'success':>9}{'distance (m)':>14}")
    for row in rows:
        print(
            f"{row['objective']:>10}{row['multiplier']:7.3f}{row['ms_per_pair']:9.2f}{row['decisions_per_pair']:11.1f}"
            f"{row['planning_share']:10.1%}{row['success_rate']:9.1%}{row['mean_distance']:14.3f}"
        )
    print(f"{arguments.pairs} pairs of the car C = {plan.multiplier:g}, seconds (median of {_TURNS})")
    for row in campaigns:
        print(
            f"{row['objective']:>10}  one worker {row['one_worker']:.2f}, two {row['two_workers']:.2f}: "
            f"{row['ratio']:.2f} times as fast"
        )


if __name__ == "__main__":
    main()
