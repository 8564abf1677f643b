"""How fast kamikaze episodes run on one core: the basic car at two multipliers, synthetic φ, the default budget.

Everything is compiled before the clock starts. `planning` is the tree search; `rest` is belief, world and car.

    python benchmarks/kamikaze.py [--episodes N] [--json]
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from skd_adversary.planner import Planner
from skd_adversary.warm_up import warm_up_episodes
from skd_evaluator.campaign import Plan, Stage, episode_id, safe_trajectories
from skd_evaluator.runner import run_episode
from skd_evaluator.workers import InProcessRunner
from skd_sim.episode import Episode, Mode, Outcome
from skd_sim.scenario import load_scenario
from skd_sim.trajectory import Trajectory

_MULTIPLIERS = (1.0, 1.15)
_SAFE_COUNT = 5


class _Clock:
    """Adds up the time and the number of planning decisions."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self.decisions = 0


@contextmanager
def _timed_planner() -> Iterator[_Clock]:
    clock, plan = _Clock(), Planner.plan

    def timed(self: Planner, belief: object) -> int:
        begin = time.perf_counter()
        action = plan(self, belief)  # type: ignore[arg-type]
        clock.seconds += time.perf_counter() - begin
        clock.decisions += 1
        return action

    Planner.plan = timed  # type: ignore[method-assign]
    try:
        yield clock
    finally:
        Planner.plan = plan  # type: ignore[method-assign]


def _measure(plan: Plan, safe: list[Trajectory], count: int) -> dict[str, float]:
    episodes = [
        Episode(
            plan.scenario,
            Mode.KAMIKAZE,
            plan.seed,
            episode_id(Stage.KAMIKAZE, number % len(safe), number // len(safe)),
            multiplier=plan.multiplier,
            safe_trajectory=safe[number % len(safe)],
            simulations=plan.simulations,
        )
        for number in range(count)
    ]
    for episode in episodes[: len(safe)]:
        run_episode(episode)
    with _timed_planner() as clock:
        begin = time.perf_counter()
        logs = [run_episode(episode) for episode in episodes]
        seconds = time.perf_counter() - begin
    return {
        "episodes": count,
        "episodes_per_second": count / seconds,
        "ms_per_episode": 1000.0 * seconds / count,
        "decisions_per_second": clock.decisions / seconds,
        "decisions_per_episode": clock.decisions / count,
        "planning_share": clock.seconds / seconds,
        "success_rate": sum(log.outcome == Outcome.COLLISION for log in logs) / count,
    }


def main() -> None:
    """Measure, and print a table or JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=200, metavar="N", help="per multiplier (default 200)")
    parser.add_argument("--json", action="store_true", help="print JSON: multiplier → figures")
    arguments = parser.parse_args()
    if arguments.episodes < 1:
        parser.error("--episodes must be at least 1")
    plan = Plan(load_scenario("crossing"), safe_count=_SAFE_COUNT)
    runner = InProcessRunner(1)
    runner.start(warm_up_episodes())
    safe = safe_trajectories(plan, runner)
    results = {c: _measure(replace(plan, multiplier=c), safe, arguments.episodes) for c in _MULTIPLIERS}
    if arguments.json:
        print(json.dumps({"simulations": plan.simulations, "multipliers": results}, indent=2))
        return
    print(f"Kamikaze episodes of the basic car on one core, {plan.simulations} simulations per decision")
    print(f"{'C':>6}{'episodes/s':>12}{'ms/episode':>12}{'decisions/s':>13}{'planning':>10}{'rest':>8}{'success':>10}")
    for c, row in results.items():
        print(
            f"{c:6.3f}{row['episodes_per_second']:12.1f}{row['ms_per_episode']:12.1f}"
            f"{row['decisions_per_second']:13.0f}{row['planning_share']:10.1%}{1.0 - row['planning_share']:8.1%}"
            f"{row['success_rate']:10.1%}"
        )


if __name__ == "__main__":
    main()
