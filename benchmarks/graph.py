"""How fast the node graph is: four processes in lockstep, and where their time goes.

    python benchmarks/graph.py [--episodes 60] [--json]

Kamikaze episodes plan at every tick (1000 simulations, the default); replay episodes only pass messages on, so a tick
of theirs is transport alone. Planning is timed in process, over the same episodes; recording by running them again with
a bag each. Ticks are timed where the evaluator sees them.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from skd_adversary.adversary import make_adversary
from skd_adversary.warm_up import warm_up_episodes
from skd_evaluator.campaign.plan import Plan, safe_trajectories, single_episode
from skd_evaluator.campaign.runner import run_episode
from skd_evaluator.campaign.workers import InProcessRunner
from skd_evaluator.ros.options import GraphOptions
from skd_evaluator.ros.session import graph_session, prepare_ros
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.state import CarState

TARGET_EPISODES, TARGET_RECORDED = 50.0, 35.0  # kamikaze episodes per second
TARGET_TICK = 1e-3  # s, median of a tick without planning
WARM_UP = 5  # episodes


class Watch:
    """Notes when an evaluator publishes an episode, sees each state, and has it finished."""

    def __init__(self, evaluator: Any) -> None:
        self.ticks: list[float] = []
        self.first: list[float] = []
        self.last: list[float] = []
        self._arrivals: list[float] = []
        self._published = 0.0
        self._evaluator = evaluator
        on_state = evaluator._samples.add_car

        def add_car(stamp: int, *state: float) -> None:
            if stamp not in evaluator._samples.car:
                self._arrivals.append(time.perf_counter())
            on_state(stamp, *state)

        evaluator._samples.add_car = add_car
        publisher = evaluator._episode_publisher
        publish = publisher.publish

        def publish_episode(message: Any) -> None:
            self._published = time.perf_counter()
            publish(message)

        publisher.publish = publish_episode

    def run(self, episodes: Sequence[Episode]) -> tuple[float, list[EpisodeLog]]:
        """Run episodes, and return seconds and logs."""
        for times in (self.ticks, self.first, self.last):
            times.clear()
        logs = []
        begin = time.perf_counter()
        for episode in episodes:
            self._arrivals.clear()
            logs.append(self._evaluator.run_episode(episode))
            self.last.append(time.perf_counter() - self._arrivals[-1])
            self.first.append(self._arrivals[0] - self._published)
            self.ticks += [after - before for before, after in zip(self._arrivals, self._arrivals[1:], strict=False)]
        seconds = time.perf_counter() - begin
        broken = [log.reason for log in logs if log.outcome == Outcome.ABORTED]
        if broken:
            raise SystemExit(f"{len(broken)} episodes were aborted: {broken[0]}")
        return seconds, logs


def planning_seconds(logs: Sequence[EpisodeLog]) -> float:
    """Time that the adversary thinks in these episodes: from making it to its last decision."""
    total = 0.0
    for log in logs:
        begin = time.perf_counter()
        adversary = make_adversary(log.episode)
        for x, y, speed in log.car[:-1]:
            adversary.act(CarState(x, y, 1.5707963267948966, speed))
        total += time.perf_counter() - begin
    return total


def measure(episodes: int) -> dict[str, Any]:
    """Run everything."""
    plan = Plan(load_scenario("crossing"), safe_count=1)
    for episode in warm_up_episodes():
        run_episode(episode)
    safe = safe_trajectories(plan, InProcessRunner(1))[0]
    kamikaze = [single_episode(plan, Mode.KAMIKAZE, attempt, safe) for attempt in range(episodes + WARM_UP)]
    replay = [single_episode(plan, Mode.REPLAY, attempt, safe) for attempt in range(2 * episodes + WARM_UP)]
    runs: dict[str, tuple[float, list[EpisodeLog], list[float], list[float], list[float]]] = {}
    startup = 0.0
    for recorded in (False, True):
        with tempfile.TemporaryDirectory() as scratch:
            bags = Path(scratch) / "bags" if recorded else None
            begin = time.perf_counter()
            with graph_session(
                GraphOptions(), controller="basic", campaign="benchmark", log_folder=Path(scratch), record_to=bags
            ) as evaluator:
                watch = Watch(evaluator)
                for name, batch in (("kamikaze", kamikaze), ("replay", replay)):
                    watch.run(batch[:WARM_UP])
                    if not startup:
                        startup = time.perf_counter() - begin
                    seconds, logs = watch.run(batch[WARM_UP:])
                    key = f"{name}, recorded" if recorded else name
                    runs[key] = seconds, logs, list(watch.ticks), list(watch.first), list(watch.last)
    result: dict[str, Any] = {"cores": len(os.sched_getaffinity(0)), "startup_s": startup}
    for name, (seconds, logs, ticks, first, last) in runs.items():
        result[name] = {
            "episodes": len(logs),
            "episodes_per_s": len(logs) / seconds,
            "ticks_per_s": sum(len(log.pedestrian) - 1 for log in logs) / seconds,
            "tick_median_ms": 1e3 * statistics.median(ticks),
            "tick_p95_ms": 1e3 * sorted(ticks)[int(0.95 * len(ticks))],
            "to_first_state_median_ms": 1e3 * statistics.median(first),
            "after_last_state_median_ms": 1e3 * statistics.median(last),
            "slowest_tick_ms": 1e3 * max(ticks),
        }
    seconds, logs = runs["kamikaze, recorded"][:2]
    planning = planning_seconds(logs)
    recording = max(0.0, seconds - runs["kamikaze"][0])
    result["shares"] = {
        "planning": planning / seconds,
        "recording": recording / seconds,
        "transport": 1.0 - (planning + recording) / seconds,
    }
    result["targets_met"] = {
        "kamikaze episodes per second": result["kamikaze"]["episodes_per_s"] >= TARGET_EPISODES,
        "the same, recorded": result["kamikaze, recorded"]["episodes_per_s"] >= TARGET_RECORDED,
        "median tick without planning": result["replay"]["tick_median_ms"] < 1e3 * TARGET_TICK,
    }
    return result


def main() -> int:
    """Measure, and print a table or JSON; exit code 1 where a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=60, help="kamikaze episodes to measure (default 60)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    arguments = parser.parse_args()
    prepare_ros()
    result = measure(arguments.episodes)
    if arguments.json:
        print(json.dumps(result, indent=2))
    else:
        names = [name for name in result if isinstance(result[name], dict) and "ticks_per_s" in result[name]]
        print(f"{result['cores']} cores; nodes up and warm after {result['startup_s']:.1f} s\n")
        print(f"{'':28}" + "".join(f"{name:>21}" for name in names))
        for key in result[names[0]]:
            print(f"{key:28}" + "".join(f"{result[name][key]:21.2f}" for name in names))
        print("\nkamikaze, recorded: " + ", ".join(f"{name} {share:.0%}" for name, share in result["shares"].items()))
        for name, met in result["targets_met"].items():
            print(f"{name}: target {'met' if met else 'MISSED'}")
    return 0 if all(result["targets_met"].values()) else 1


if __name__ == "__main__":
    sys.exit(main())
