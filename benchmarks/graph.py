"""How fast the node graph is: four nodes in lockstep, and where their time goes.

    python benchmarks/graph.py [--episodes 60] [--part ticks|control|composed|real_time] [--turns 3] [--json]

Four parts, all by default.

*ticks*: kamikaze episodes plan at every tick (1000 simulations, the default); replay episodes only pass messages on, so
a tick of theirs is transport alone. Planning is timed in process, over the same episodes; recording by running them
again with a bag each. Ticks are timed where the evaluator sees them.

*control*: lockstep with a car that decides every 0.02 s, and nobody but SKD's own nodes listening.

*composed*: simulator and adversary in the evaluator's process against processes of their own, in turns. In each turn
both graphs run kamikaze episodes and then the car that decides every 0.02 s, and the kamikaze episodes again with a bag
each. Printed are, for an episode or a control period, how many a second and the processor time of all processes of
the graph, which says less of a busy machine's others: medians over the turns, and the median, the least and the
greatest of the turns' ratios.

*real_time*: states at 100 Hz, scans of 1,441 beams at 20 Hz with a subscriber in a process of its own, at rate 1; a
state is late when it arrives a control period or more after its time.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from skd_adversary.adversary import make_adversary
from skd_adversary.warm_up import warm_up_episodes
from skd_evaluator.assessing.graph_options import COMPOSED, SEPARATE, GraphOptions
from skd_evaluator.campaign.plan.plan import Plan, safe_trajectories
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.campaign.run.workers import InProcessRunner, single_episode
from skd_evaluator.ros.session import graph_session, prepare_ros
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.state import CarState

TARGET_EPISODES, TARGET_RECORDED = 50.0, 35.0  # kamikaze episodes per second
TARGET_TICK = 1e-3  # s, median of a tick without planning
TARGET_CONTROL = 300.0  # control periods per second of wall time, in lockstep
TARGET_COMPOSED = {"kamikaze": 150.0, "kamikaze, recorded": 100.0, "control": 4000.0}  # 1/s, of a composed graph
TARGET_LATE = 0.01  # share of states that come a control period late, at most
WARM_UP = 5  # episodes
PARTS = ("ticks", "control", "composed", "real_time")
LISTENER = """
import rclpy
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan

heard = []
rclpy.init()
node = rclpy.create_node("scan_listener")
node.create_subscription(LaserScan, "/ego/scan", lambda scan: heard.append(len(scan.ranges)), qos_profile_sensor_data)
try:
    rclpy.spin(node)
except BaseException:
    print(len(heard), max(heard, default=0), flush=True)
"""


class Watch:
    """Notes when an evaluator publishes an episode, sees each state, and has it finished."""

    def __init__(self, evaluator: Any) -> None:
        self.ticks: list[float] = []
        self.first: list[float] = []
        self.last: list[float] = []
        self.arrivals: list[float] = []
        self._published = 0.0
        self._evaluator = evaluator
        on_state = evaluator._samples.add_car

        def add_car(stamp: int, *state: float) -> None:
            if stamp not in evaluator._samples.car:
                self.arrivals.append(time.perf_counter())
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
            self.arrivals.clear()
            logs.append(self._evaluator.run_episode(episode))
            self.last.append(time.perf_counter() - self.arrivals[-1])
            self.first.append(self.arrivals[0] - self._published)
            self.ticks += [after - before for before, after in zip(self.arrivals, self.arrivals[1:], strict=False)]
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


def processor_seconds() -> float:
    """Time that this process and all that came of it have used processors; it says less of a busy machine's others."""
    parents, used = {}, {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:  # it has ended meanwhile
            continue
        number = int(stat.parent.name)
        parents[number], used[number] = int(fields[1]), int(fields[11]) + int(fields[12])
    ours = {os.getpid()}
    while more := {number for number, parent in parents.items() if parent in ours} - ours:
        ours |= more
    return sum(used.get(number, 0) for number in ours) / os.sysconf("SC_CLK_TCK")


def replays(count: int, control_period: float) -> list[Episode]:
    """Episodes along a synthetic φ, with a car that decides so often."""
    scenario = dataclasses.replace(load_scenario("crossing"), control_period=control_period)
    plan = Plan(scenario, safe_count=1)
    safe = safe_trajectories(plan, InProcessRunner(1))[0]
    return [single_episode(plan, Mode.REPLAY, attempt, safe) for attempt in range(count)]


def measure_control(episodes: int) -> dict[str, Any]:
    """Lockstep at 50 Hz: how many control periods fit into a second."""
    period = 0.02
    batch = replays(episodes + WARM_UP, period)
    with (
        tempfile.TemporaryDirectory() as scratch,
        graph_session(
            GraphOptions(), controller="basic", campaign="benchmark", log_folder=Path(scratch), record_to=None
        ) as evaluator,
    ):
        watch = Watch(evaluator)
        watch.run(batch[:WARM_UP])
        seconds, logs = watch.run(batch[WARM_UP:])
        ticks = sorted(watch.ticks)
    return {
        "episodes": len(logs),
        "control_periods_per_s": len(ticks) / seconds,
        "times_real_time": len(ticks) * period / seconds,
        "median_ms": 1e3 * statistics.median(ticks),
        "p95_ms": 1e3 * ticks[int(0.95 * len(ticks))],
        "targets_met": {"control periods per second": len(ticks) / seconds >= TARGET_CONTROL},
    }


def paces(
    nodes: str, warm_up: list[Episode], kamikaze: list[Episode], control: list[Episode]
) -> dict[str, tuple[float, float]]:
    """Return, for graphs whose simulator and adversary run there, how many a second, and processor ms for each."""
    found = {}
    options = GraphOptions(nodes=nodes)
    for recorded in (False, True):
        with tempfile.TemporaryDirectory() as scratch:
            bags = Path(scratch) / "bags" if recorded else None
            with graph_session(
                options, controller="basic", campaign="benchmark", log_folder=Path(scratch), record_to=bags
            ) as evaluator:
                watch = Watch(evaluator)
                for number, episode in enumerate(warm_up):
                    watch.run([episode])
                    if number + 1 == WARM_UP:
                        break
                used = processor_seconds()
                seconds, logs = watch.run(kamikaze)
                pace = len(logs) / seconds, 1e3 * (processor_seconds() - used) / len(logs)
                found["kamikaze, recorded" if recorded else "kamikaze"] = pace
                if not recorded:
                    watch.run(control[:1])
                    used = processor_seconds()
                    seconds, _ = watch.run(control[1:])
                    periods = len(watch.ticks)
                    found["control"] = periods / seconds, 1e3 * (processor_seconds() - used) / periods
    return found


def measure_composed(episodes: int, turns: int) -> dict[str, Any]:
    """Composed against separate, in turns."""
    plan = Plan(load_scenario("crossing"), safe_count=1)
    safe = safe_trajectories(plan, InProcessRunner(1))[0]
    attempts = [single_episode(plan, Mode.KAMIKAZE, attempt, safe) for attempt in range(WARM_UP + episodes)]
    batches = attempts[:WARM_UP], attempts[WARM_UP:], replays(episodes // 2 + 1, 0.02)
    both = (SEPARATE, COMPOSED)
    found = [{nodes: paces(nodes, *batches) for nodes in both} for _ in range(turns)]
    result: dict[str, Any] = {"turns": turns}
    for what in TARGET_COMPOSED:
        result[what] = {}
        for name, number in (("per_s", 0), ("processor_ms", 1)):
            ratios = sorted(turn[COMPOSED][what][number] / turn[SEPARATE][what][number] for turn in found)
            for nodes in both:
                result[what][f"{name}_{nodes}"] = statistics.median(turn[nodes][what][number] for turn in found)
            result[what][f"{name}_ratio"] = statistics.median(ratios)
            result[what] |= {f"{name}_least": ratios[0], f"{name}_greatest": ratios[-1]}
    met = {
        f"{what} per second, composed": result[what][f"per_s_{COMPOSED}"] >= least
        for what, least in TARGET_COMPOSED.items()
    }
    return {**result, "targets_met": met}


def measure_real_time(episodes: int) -> dict[str, Any]:
    """Real time with states at 100 Hz and somebody who listens to scans at 20 Hz: how late states are."""
    period, scan_rate = 0.01, 20.0
    batch = replays(episodes + 1, period)
    late: list[float] = []
    states = 0
    with tempfile.TemporaryDirectory() as scratch:
        options = GraphOptions(pacing="real_time", rate_factor=1.0, scan_rate=scan_rate)
        with graph_session(
            options, controller="basic", campaign="benchmark", log_folder=Path(scratch), record_to=None
        ) as evaluator:
            where = {**os.environ, "ROS_DOMAIN_ID": str(evaluator.context.get_domain_id())}
            command = [sys.executable, "-c", LISTENER]
            listener = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=where)
            watch = Watch(evaluator)
            watch.run(batch[:1])
            begin, used = time.perf_counter(), processor_seconds()
            for episode in batch[1:]:
                watch.run([episode])
                # The first state waits for a controller; the clock of an episode starts with its answer.
                first = watch.arrivals[1]
                late += [at - (first + number * period) for number, at in enumerate(watch.arrivals[1:])]
                states += len(watch.arrivals)
            cores = (processor_seconds() - used) / (time.perf_counter() - begin)
            listener.send_signal(signal.SIGINT)
            heard, beams = map(int, (listener.communicate(timeout=20)[0] or "0 0").split())
    late.sort()
    return {
        "episodes": len(batch) - 1,
        "states": states,
        "late_median_ms": 1e3 * statistics.median(late),
        "late_p99_ms": 1e3 * late[int(0.99 * len(late))],
        "late_worst_ms": 1e3 * late[-1],
        "late_share": sum(one >= period for one in late) / len(late),
        "cores_used": cores,
        "scans_heard": heard,
        "beams": beams,
        "targets_met": {"states in time": sum(one >= period for one in late) / len(late) <= TARGET_LATE},
    }


def measure_ticks(episodes: int) -> dict[str, Any]:
    """Kamikaze episodes and runs along φ, with and without recording."""
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
            "ticks_per_s": sum(len(log.adversary) - 1 for log in logs) / seconds,
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
    parser.add_argument("--part", choices=PARTS, action="append", help="measure this only; can be given several times")
    parser.add_argument("--turns", type=int, default=3, help="turns of composed and separate graphs (default 3)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    arguments = parser.parse_args()
    prepare_ros(GraphOptions())
    parts = arguments.part or PARTS
    result: dict[str, Any] = {}
    if "ticks" in parts:
        result = measure_ticks(arguments.episodes)
    if "control" in parts:
        result["control"] = measure_control(arguments.episodes)
    if "composed" in parts:
        result["composed"] = measure_composed(arguments.episodes, arguments.turns)
    if "real_time" in parts:
        result["real_time"] = measure_real_time(max(1, arguments.episodes // 6))
    met = dict(result.get("targets_met", {}))
    for part in ("control", "composed", "real_time"):
        met |= result.get(part, {}).get("targets_met", {})
    if arguments.json:
        print(json.dumps(result, indent=2))
        return 0 if all(met.values()) else 1
    if "ticks" in parts:
        names = [name for name in result if isinstance(result[name], dict) and "ticks_per_s" in result[name]]
        print(f"{result['cores']} cores; nodes up and warm after {result['startup_s']:.1f} s\n")
        print(f"{'':28}" + "".join(f"{name:>21}" for name in names))
        for key in result[names[0]]:
            print(f"{key:28}" + "".join(f"{result[name][key]:21.2f}" for name in names))
        print("\nkamikaze, recorded: " + ", ".join(f"{name} {share:.0%}" for name, share in result["shares"].items()))
    for what in TARGET_COMPOSED if "composed" in parts else ():
        figures = result["composed"][what]
        print(f"{what}: " + ", ".join(f"{name} {value:.4g}" for name, value in figures.items()))
    for part in ("control", "real_time"):
        figures = {name: value for name, value in result.get(part, {}).items() if name != "targets_met"}
        if figures:
            print(f"{part}: " + ", ".join(f"{name} {value:.4g}" for name, value in figures.items()))
    for name, reached in met.items():
        print(f"{name}: target {'met' if reached else 'MISSED'}")
    return 0 if all(met.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
