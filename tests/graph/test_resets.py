"""How a stack gets to know of a new episode: its start pose, its lifecycle, or a restart."""

import contextlib
import dataclasses
import itertools
import re
import shlex
import socket
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from common import new_domain
from graph_support import HERE, assert_same_log, whole_graph
from lifecycle_msgs.msg import State
from managed_node import LatchingBrake
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.task import Future
from skd_evaluator.assessment.options import GraphOptions
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.bags.read import read_bags
from skd_evaluator.ros import stack as stack_module
from skd_evaluator.ros.graph import is_in_use
from skd_evaluator.ros.stack import LifecycleNodes
from skd_sim.world.episode import EpisodeSpec, Outcome

NAME = "/latching_brake"


def test_a_managed_node_forgets(tmp_path: Path, replay: EpisodeSpec) -> None:
    """It brakes for ever once it has braked, unless it is cleaned up; and it is told where each episode starts."""
    command = shlex.join([sys.executable, str(HERE / "managed_node.py")])
    options = GraphOptions(controller_command=command, reset="lifecycle,initialpose", lifecycle_nodes=NAME)
    theirs = dataclasses.replace(replay, controller="external", adversary_model="generic")
    with whole_graph(tmp_path, options) as (evaluator, _):
        logs = [evaluator.run_episode(theirs) for _ in range(2)]
    assert logs[0].outcome != Outcome.ABORTED, logs[0].reason
    assert_same_log(*logs)
    speeds = logs[0].car[:, 3]
    assert speeds[1] > 0.94 * speeds[0]  # not braking yet: its noise is 5 %
    assert speeds[-1] < 0.5 * speeds[0]
    printed = (tmp_path / "car_controller.log").read_text().splitlines()
    up, down = ["configure", "activate"], ["deactivate", "cleanup"]
    transitions = [line.split()[-1] for line in printed if line.startswith("transitions: ")]
    assert transitions == ["created", *up, *down, *up, *down]
    poses = [line.split()[1:] for line in printed if line.startswith("pose: ")]
    start = [repr(float(value)) for value in logs[0].car[0, :2]]
    assert all(pose[1:] == ["map", *start] for pose in poses)
    # The second subscription may come soon enough for what was latched in the first episode.
    stamps = [int(pose[0]) for pose in poses]
    assert stamps == sorted(stamps)
    assert len(set(stamps)) == 2


@pytest.fixture
def brake(domain: int) -> Iterator[Any]:
    executor = SingleThreadedExecutor()
    ended = threading.Event()
    made: list[Any] = []

    def spin() -> None:
        while not ended.is_set():
            executor.spin_once(timeout_sec=0.02)

    thread = threading.Thread(target=spin)

    def make(refuse: str = "nothing") -> Any:
        node = LatchingBrake(parameter_overrides=[Parameter("refuse", value=refuse)])
        made.append(node)
        executor.add_node(node)
        thread.start()
        return node

    yield make
    ended.set()
    if made:
        thread.join()
    executor.shutdown()
    for node in made:
        node.destroy_node()


@contextlib.contextmanager
def managed(patience: float = 30.0, name: str = NAME) -> Iterator[LifecycleNodes]:
    nodes = LifecycleNodes(rclpy.get_default_context(), [name], patience)
    try:
        yield nodes
    finally:
        nodes.close()


@pytest.mark.parametrize("found", ["unconfigured", "inactive", "active"])
def test_whatever_state_it_is_found_in(brake: Any, capsys: pytest.CaptureFixture[str], found: str) -> None:
    node = brake()
    if found != "unconfigured":
        node.trigger_configure()
    if found == "active":
        node.trigger_activate()
    capsys.readouterr()
    with managed() as nodes:
        assert nodes.before_episode() is None
        down = {"unconfigured": [], "inactive": ["cleanup"], "active": ["deactivate", "cleanup"]}[found]
        assert re.findall(r"transitions: (\w+)", capsys.readouterr().out) == [*down, "configure", "activate"]
    assert re.findall(r"transitions: (\w+)", capsys.readouterr().out) == ["deactivate", "cleanup"]


@pytest.mark.parametrize(
    ("refuse", "said"),
    [
        ("configure", "did not configure; it is unconfigured now"),
        ("activate", "did not activate; it is inactive now"),
        ("to go on", "is finalized: it has to be started anew"),
    ],
)
def test_a_node_that_refuses(brake: Any, refuse: str, said: str) -> None:
    node = brake(refuse=refuse)
    if refuse == "to go on":
        node.trigger_shutdown()
    with managed() as nodes:
        assert nodes.before_episode() == f"failed: {NAME}, a managed node of the car controller, {said}"


def test_a_node_that_is_not_there(brake: Any) -> None:
    brake()
    with managed(1.0, "/latching_break") as nodes:
        assert nodes.before_episode() == (
            "not started: /latching_break, a managed node of the car controller, is not there: no node offers "
            "/latching_break/get_state (waited 1 s)"
        )


@pytest.mark.parametrize("lost", ["request", "answer"])
@pytest.mark.parametrize("service", ["_get", "_change"])
def test_a_lost_message_is_no_silence(brake: Any, monkeypatch: pytest.MonkeyPatch, service: str, lost: str) -> None:
    """DDS drops the answer to a client that the server has not discovered yet: it is asked for again."""
    brake()
    monkeypatch.setattr(stack_module, "_LOST_AFTER", 0.5)
    with managed() as nodes:
        client = getattr(nodes, service)[NAME]
        call, calls = client.call_async, itertools.count()

        def lossy(request: Any) -> Any:
            if next(calls):
                return call(request)
            if lost == "answer":
                call(request)
            return Future()

        monkeypatch.setattr(client, "call_async", lossy)
        assert nodes.before_episode() is None
        assert nodes._settled(NAME) == State.PRIMARY_STATE_ACTIVE


@pytest.mark.parametrize("port", [0, 11, 10 + 2 * 60])
def test_a_domain_in_which_any_port_is_held_is_not_free(port: int) -> None:
    """A process numbers its participants across all domains, so that any port may be the only one."""
    domain = new_domain()
    assert not is_in_use(domain)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", 7400 + 250 * domain + port))
        assert is_in_use(domain)


def test_a_controller_that_is_started_anew_each_time_changes_nothing(tmp_path: Path, replay: EpisodeSpec) -> None:
    wanted = [dataclasses.replace(replay, episode_id=replay.episode_id + number) for number in range(3)]
    bags = tmp_path / "bags"
    with whole_graph(tmp_path, GraphOptions(reset="restart"), record_to=bags) as (evaluator, _):
        logs = list(evaluator.run(wanted))
    for log, one in zip(logs, wanted, strict=True):
        assert_same_log(log, run_episode(one))
    recorded = {one.log.episode.episode_id: one.log for one in read_bags([bags]).episodes}
    assert len(recorded) == len(wanted)
    for log in logs:
        assert_same_log(recorded[log.episode.episode_id], log)
