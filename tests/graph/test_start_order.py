"""Nodes come and go in any order; no episode hangs, and no process is left behind."""

import contextlib
import json
import os
import shlex
import signal
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.context import ForkServerContext, ForkServerProcess
from pathlib import Path

import graph_support
import pytest
from common import PATIENCE, new_domain, wait_until
from graph_nodes import CONTROLLER, EVALUATOR, NODES, start_node, wait_for_end
from skd_evaluator.assessment.options import GraphOptions
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.bags.read import read_bags
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Outcome

STAGGER = 0.1  # s between two starts
AT_ONCE = 4  # graphs


def end(processes: list[ForkServerProcess]) -> list[int | None]:
    """End processes and return their exit codes; each has ended by itself on SIGTERM, or fails the test."""
    for process in processes:
        process.terminate()
    codes = [wait_for_end(process) for process in processes]
    for process in processes:
        process.kill()
        wait_for_end(process)
    assert not [process.pid for process in processes if Path(f"/proc/{process.pid}").exists()]
    return codes


def run_order(context: ForkServerContext, folder: Path, plan: Plan, order: tuple[str, ...]) -> EpisodeLog:
    """Run one episode with the nodes started in an order, and return what was recorded."""
    domain = new_domain()
    folder.mkdir()
    wanted = {"safe": plan.safe, "safe_count": plan.safe_count, "simulations": plan.simulations}
    parameters: dict[str, dict[str, object]] = {EVALUATOR: {"task": "episode", **wanted, "out": folder / "out"}}
    started: dict[str, ForkServerProcess] = {}
    codes = []
    try:
        for name in order:
            started[name] = start_node(context, name, folder / name, domain, **parameters.get(name, {}))
            time.sleep(STAGGER)
        assert wait_for_end(started[EVALUATOR]) == 0, (folder / EVALUATOR).read_text()
    finally:
        codes = end([started[name] for name in started if name != EVALUATOR])
        end([started[EVALUATOR]] if EVALUATOR in started else [])
    assert codes == [0, 0, 0]
    return read_bags([folder / "out" / "bags"]).episodes[0].log


def test_each_node_may_be_the_last(context, tmp_path, plan, expected):
    orders = [(*NODES[place + 1 :], *NODES[: place + 1]) for place in range(len(NODES))]
    with ThreadPoolExecutor(AT_ONCE) as pool:
        jobs = [pool.submit(run_order, context, tmp_path / str(i), plan, order) for i, order in enumerate(orders)]
        for order, job in zip(orders, jobs, strict=True):
            try:
                graph_support.assert_same_log(job.result(), expected)
            except AssertionError as error:
                raise AssertionError(f"order {order}: {error}") from error


def is_dead(pid: int) -> bool:
    """Whether a process has ended, waited for by its parent or not."""
    with contextlib.suppress(FileNotFoundError):
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        return state == "Z" and len(list(Path(f"/proc/{pid}/task").iterdir())) == 1  # all its threads too
    return True


def kill(pid: int, number: int) -> None:
    """End a process and wait until it is dead, though perhaps not yet waited for."""
    os.kill(pid, number)

    wait_until(lambda: is_dead(pid), f"the end of {pid}")


def test_restarted_between_episodes(tmp_path: Path, episode: EpisodeSpec, expected: EpisodeLog) -> None:
    with graph_support.whole_graph(tmp_path, GraphOptions(nodes="separate")) as (evaluator, token):
        graph_support.assert_same_log(evaluator.run_episode(episode), expected)
        for node in ("car_controller", "adversary", "vehicle_simulator"):
            kill(graph_support.of_node(token, node), signal.SIGKILL)
        graph_support.assert_same_log(evaluator.run_episode(episode), expected)


def test_somebody_elses_controller_comes_and_goes(context, tmp_path, episode, expected):
    """Nobody watches it: its silence is what ends the episode, and the next one takes whoever is there then."""
    domain = new_domain()
    controllers: list[ForkServerProcess] = []

    def new_controller() -> None:
        controllers.append(start_node(context, CONTROLLER, tmp_path / "controller", domain, controller="basic"))

    options = GraphOptions(nodes="separate", startup_timeout=3.0)
    try:
        with graph_support.whole_graph(tmp_path, options, controller="external", domain=domain) as (evaluator, token):
            wait_until(lambda: len(graph_support.pids_with(token)) >= 2, "the other nodes")
            log = evaluator.run_episode(episode)
            assert log.outcome == Outcome.ABORTED
            assert "car controller" in log.reason
            assert "silent" in log.reason

            def run() -> EpisodeLog | None:
                log = evaluator.run_episode(episode)
                late = log.outcome == Outcome.ABORTED and "silent" in log.reason  # it was not there within the 3 s
                return None if late else log

            new_controller()
            graph_support.assert_same_log(wait_until(run, "the new controller"), expected)
    finally:
        codes = end(controllers)
    assert codes == [0]


MISBEHAVIOUR = {
    "Killed": "process ended: car_controller was killed by signal 9",
    "Raises": "process ended: car_controller ended with exit code 1",
    "Silent": "no answer: the car controller (ego/acceleration_command) stayed silent for 2 s at tick 3",
}


@pytest.fixture(scope="module")
def misbehaved(tmp_path_factory: pytest.TempPathFactory, safe: Path) -> dict[str, tuple[Path, graph_support.Finished]]:
    """A campaign with each of them, all at once."""
    folder = tmp_path_factory.mktemp("misbehaviour")
    programs = {
        controller: graph_support.Skd(
            *("assess", "--graph", "--record", "--adversary-model", "generic"),
            *("--margin-limit", 0, "--behaviour", "none"),
            *("--controller", f"misbehaving:{controller}", "-p", f"startup_timeout:={PATIENCE}"),
            *("-p", f"command_timeout:={2 if controller == 'Silent' else PATIENCE}"),
            *("--safe", safe, "--safe-count", 1, "--kamikaze-count", 2, "--collision-runs", 2),
            *("--simulations", 100, "--out", folder / controller),
            environment={
                "PYTHONPATH": str(graph_support.HERE / "controllers"),
                "SKD_TEST_MARKER": str(folder / f"{controller}-marker"),
            },
        )
        for controller in MISBEHAVIOUR
    }
    return {controller: (folder / controller, program.finish()) for controller, program in programs.items()}


@pytest.mark.parametrize(("controller", "reason"), MISBEHAVIOUR.items())
def test_misbehaviour_during_an_episode(misbehaved, tmp_path, capsys, controller, reason):
    """The episode is aborted with the reason, the campaign goes on, and offline it counts as it did live."""
    out, finished = misbehaved[controller]
    assert finished.code in (0, 1), finished.err
    result = json.loads((out / "assessment.json").read_text())
    assert result["aborted"] == 1
    assert (result["kamikaze_trials"], result["collision_runs"]) == (2, 1)  # it was the first run along φ
    recorded = read_bags([out / "bags"]).episodes
    logs = [one.log for one in recorded if one.log.outcome == Outcome.ABORTED]
    assert len(logs) == 1
    assert logs[0].reason.startswith(reason)
    said = [line for line in finished.lines if line.startswith("skd: an episode was aborted, the first one so: ")]
    assert len(said) == 1
    assert f"so: {logs[0].reason}; log: " in said[0]
    kind, where = reason.partition(":")[0], out / "logs" / "car_controller.log"
    assert f"skd assess: why episodes were aborted: 1 {kind}; log: {where}" in finished.lines
    assert sum("was aborted and counts for nothing" in line for line in finished.lines) == 1
    words = {"Raises": "failed with RuntimeError: sensor fusion has diverged", "Killed": "was killed by signal 9"}
    for who, said_of in words.items():
        assert any(said_of in line for line in finished.lines) == (controller == who)
    assert len(logs[0].adversary) == 4  # up to the tick at which it happened
    again = graph_support.skd_here(capsys, "replay", out / "bags", "--out", tmp_path / "again")
    assert again.code == finished.code
    graph_support.assert_same_results(tmp_path / "again", out)
    warnings = json.loads((tmp_path / "again" / "assessment.json").read_text())["warnings"]
    assert f"1 episode counts for nothing, aborted (1 {kind})" in warnings


@pytest.fixture
def endless(tmp_path: Path, safe: Path) -> Iterator[graph_support.Program]:
    """A campaign that takes long, with a controller whose command starts processes of its own, one deaf to signals."""
    node = f"{shlex.quote(sys.executable)} -m skd_sim.ros.controller_node --ros-args -p controller:=misbehaving:Slow"
    deaf = tmp_path / "deaf.sh"
    deaf.write_text("trap '' HUP INT TERM\nwhile :; do sleep 1; done\n")
    program = graph_support.Program(
        graph_support.skd_command(
            *("assess", "--graph", "--record", "--adversary-model", "generic", "--controller", "external"),
            *("--controller-command", f"sh -c '{node} & sh {deaf} & wait'"),
            *("--safe", safe, "--safe-count", 1, "--out", tmp_path / "out"),
        ),
        {"PYTHONPATH": str(graph_support.HERE / "controllers")},
    )
    wait_until(lambda: len(graph_support.pids_with(program.token)) >= 5, "all processes")
    time.sleep(1.0)
    yield program
    if program.popen.poll() is None:
        program.popen.kill()
    graph_support.assert_all_gone(program.token)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_ending_the_command_ends_everything(endless: graph_support.Program, tmp_path: Path, number: int) -> None:
    assert endless.popen.poll() is None
    before = set(graph_support.pids_with(endless.token))
    assert len(before) >= 5
    endless.popen.send_signal(number)
    finished = endless.finish()
    if number == signal.SIGKILL:
        assert finished.code == -signal.SIGKILL
    else:
        assert finished.code == 130
        assert finished.timeless[-1].startswith("skd assess: interrupted; "), finished.err
        assert not [entry.name for entry in tmp_path.iterdir() if entry.name.startswith(("out", ".skd"))]
    # What SIGKILL leaves is ended by others, the watching shell, and they need a moment.
    wait_until(lambda: all(map(is_dead, before)), "their end", PATIENCE if number == signal.SIGKILL else 2.0)
