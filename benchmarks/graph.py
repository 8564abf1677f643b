"""How fast the node graph is: simulator and adversary in the evaluator's process, and in processes of their own.

    python benchmarks/graph.py [--episodes 60] [--turns 3]
    python benchmarks/graph.py --starts 300

In each turn both graphs run kamikaze episodes, the same with a bag each, and episodes of a car that decides every
0.02 s, of which nobody plans: these are control periods a second. Printed are medians over the turns, of how many a
second, and the ratio with its least and greatest.

With --starts graphs are started and ended instead, each for one episode of a car whose command starts a second process:
in turn composed and separate, and every third ends by an error. Printed is how many processes were left behind.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import os
import signal
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from skd_evaluator.assessment.options import COMPOSED, SEPARATE, GraphOptions
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories, single_episode
from skd_evaluator.ros.processes import GraphSetting
from skd_evaluator.ros.session import graph_session, prepare_ros
from skd_sim.options.car_and_adversary import AdversaryModel, CarUnderTest
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.episode import EpisodeSpec, Mode, Outcome

WARM_UP = 5  # episodes
PERIOD = 0.02  # s, of the car that decides often
GRACE = 0.2  # s in which a process that was killed is gone
TOKEN = "SKD_BENCHMARK_TOKEN"  # variable by which the processes of a graph are known


def episodes(mode: Mode, count: int, control_period: float | None = None) -> list[EpisodeSpec]:
    """Return episodes along a synthetic φ."""
    scenario = load_scenario("crossing")
    if control_period is not None:
        scenario = dataclasses.replace(scenario, control_period=control_period)
    plan = Plan(scenario, safe_count=1)
    safe = safe_trajectories(plan, InProcessRunner(1))[0]
    return [single_episode(plan, mode, trial, safe) for trial in range(count)]


def pace(nodes: str, batch: Sequence[EpisodeSpec], *, recorded: bool = False) -> tuple[float, float]:
    """Return episodes and ticks of the world a second, of a graph whose simulator and adversary run there."""
    with tempfile.TemporaryDirectory() as scratch:
        bags = Path(scratch) / "bags" if recorded else None
        setting = GraphSetting(
            options=GraphOptions(nodes=nodes), car=CarUnderTest("basic"), log_folder=Path(scratch), record_to=bags
        )
        with graph_session(setting) as evaluator:
            for episode in batch[:WARM_UP]:
                evaluator.run_episode(episode)
            begin = time.perf_counter()
            logs = [evaluator.run_episode(episode) for episode in batch[WARM_UP:]]
            seconds = time.perf_counter() - begin
    broken = [log.reason for log in logs if log.outcome == Outcome.ABORTED]
    if broken:
        raise SystemExit(f"{len(broken)} episodes were aborted: {broken[0]}")
    return len(logs) / seconds, sum(len(log.adversary) - 1 for log in logs) / seconds


def left_behind() -> list[str]:
    """Return the command lines of the living processes that inherited this one's token, and kill them."""
    token, found = f"{TOKEN}={os.environ[TOKEN]}".encode(), []
    time.sleep(GRACE)
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal() and int(entry.name) != os.getpid():
            with contextlib.suppress(OSError):
                if token in (entry / "environ").read_bytes().split(b"\0"):
                    found.append((entry / "cmdline").read_bytes().replace(b"\0", b" ").decode())
                    os.kill(int(entry.name), signal.SIGKILL)
    return found


def starts(count: int) -> None:
    """Start and end graphs, and print how many processes they left behind."""
    os.environ[TOKEN] = str(os.getpid())
    car = {"controller": "external", "adversary_model": AdversaryModel.GENERIC}
    batch = [dataclasses.replace(one, **car) for one in episodes(Mode.REPLAY, count)]
    node = f"{sys.executable} -P -m skd_sim.start car_controller --ros-args -p controller:=basic"
    command, left, aborted = f"sh -c 'sleep 1000 & exec {node}'", list[str](), 0
    ends = []
    for number, episode in enumerate(batch):
        options = GraphOptions(nodes=(COMPOSED, SEPARATE)[number % 2], controller_command=command)
        with tempfile.TemporaryDirectory() as scratch, contextlib.suppress(InterruptedError):
            setting = GraphSetting(options=options, car=CarUnderTest("external"), log_folder=Path(scratch))
            try:
                with graph_session(setting) as evaluator:
                    aborted += evaluator.run_episode(episode).outcome == Outcome.ABORTED
                    begin = time.perf_counter()
                    if number % 3 == 2:
                        raise InterruptedError
            finally:
                ends.append(time.perf_counter() - begin)
        left += left_behind()
        if (number + 1) % 50 == 0 or number + 1 == count:
            print(
                f"{number + 1} graphs: {len(left)} processes left behind {left[:1]}, {aborted} episodes aborted; "
                f"an end took {statistics.median(ends):.2f} s (median), at most {max(ends):.2f} s",
                flush=True,
            )


def main() -> None:
    """Measure, and print a line for each kind of episode."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=60, help="kamikaze episodes to measure (default 60)")
    parser.add_argument("--turns", type=int, default=3, help="turns of both graphs (default 3)")
    parser.add_argument("--starts", type=int, default=0, help="graphs to start and end instead (default none)")
    arguments = parser.parse_args()
    prepare_ros(GraphOptions())
    if arguments.starts:
        starts(arguments.starts)
        return
    kamikaze = episodes(Mode.KAMIKAZE, WARM_UP + arguments.episodes)
    often = episodes(Mode.REPLAY, WARM_UP + arguments.episodes // 2, PERIOD)
    periods = often[0].scenario.time_step / PERIOD  # a tick of the world
    kinds = {
        "kamikaze episodes/s": lambda nodes: pace(nodes, kamikaze)[0],
        "the same, recorded": lambda nodes: pace(nodes, kamikaze, recorded=True)[0],
        "control periods/s": lambda nodes: periods * pace(nodes, often)[1],
    }
    print(f"{'':22}{'separate':>10}{'composed':>10}   composed : separate")
    for name, measure in kinds.items():
        turns = [(measure(SEPARATE), measure(COMPOSED)) for _ in range(arguments.turns)]
        separate, composed = (statistics.median(column) for column in zip(*turns, strict=True))
        ratios = sorted(two / one for one, two in turns)
        print(
            f"{name:22}{separate:>10.0f}{composed:>10.0f}   {statistics.median(ratios):.2f} "
            f"({ratios[0]:.2f} to {ratios[-1]:.2f})",
            flush=True,
        )


if __name__ == "__main__":
    main()
