"""Processes that cannot start or hang, and states that are lost or contradict the world."""

import dataclasses
import gc
import os
import re
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.context import ForkServerContext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rclpy
from common import PATIENCE, wait_until
from graph_nodes import ADVERSARY, CONTROLLER, SIMULATOR, evaluator, running, start_node
from graph_support import of_node, whole_graph
from rclpy.context import Context
from skd_evaluator import AssessmentError, run_episode
from skd_evaluator.assessment.options import GraphOptions
from skd_evaluator.ros import evaluator as evaluator_module
from skd_evaluator.ros.evaluator import Evaluator, refuted
from skd_evaluator.ros.processes import AbortedEpisodes, GraphError, Program, Supervisor
from skd_sim.ros import diagnosis
from skd_sim.world.episode import AbortKind, EpisodeLog, EpisodeSpec, Outcome, abort_reason, kind_of
from skd_sim.world.state import AdversaryState, CarState


@pytest.mark.parametrize(
    ("program", "words"),
    [
        (
            "import tf2_nowhere",
            "ModuleNotFoundError: No module named 'tf2_nowhere'; the ROS 2 that SKD brings has rclpy",
        ),
        ("raise ImportError(\"No module named 'rclpy'\")", "ImportError: No module named 'rclpy'; write python3"),
        ("import sys; sys.exit(127)", "(it has printed nothing)"),
    ],
)
def test_what_can_never_start_is_not_started_again_and_again(tmp_path: Path, program: str, words: str) -> None:
    environment = {"PATH": os.environ["PATH"]}
    said: list[str] = []
    with Supervisor({"driver": Program([sys.executable, "-c", program], environment)}, tmp_path, said.append) as one:
        problems = []
        with pytest.raises(GraphError, match=re.escape(f"2 times; the last line of its log: {words}")):
            wait_until(lambda: problems.extend(filter(None, [one.check()])), "an end")
        with pytest.raises(GraphError):  # a later stage of the campaign does not wait for what does not run
            one.check()
    assert problems[0].endswith(f"; the last line of its log: {words.partition(';')[0]}")
    assert len(problems) == 1
    assert len(said) == 1


def test_a_campaign_whose_episodes_are_not_answered_ends(replay: EpisodeSpec) -> None:
    """Each takes a timeout and a start of the node; one that is answered in between begins the count anew."""
    where = np.zeros((3, 2)), np.zeros((3, 4))
    silent = EpisodeLog(replay, Outcome.ABORTED, *where, reason=abort_reason(AbortKind.NO_ANSWER, "it hangs"))
    slipped = dataclasses.replace(silent, reason=abort_reason(AbortKind.SLIPPED, "late"))
    failures = AbortedEpisodes(lambda _line: None)
    for log in [*9 * [silent], slipped, *9 * [silent]]:
        failures.note(log)
    with pytest.raises(AssessmentError, match=r"10 episodes in a row were not answered, the last one so: .*it hangs"):
        failures.note(silent)
    twice = dataclasses.replace(silent, reason=abort_reason(AbortKind.ANSWERED_TWICE, "publish once"))
    for log in [twice, twice, slipped, twice, twice]:
        failures.note(log)
    with pytest.raises(AssessmentError, match=r"3 episodes in a row failed, the last one so: .*publish once"):
        failures.note(twice)


def test_a_node_that_does_not_answer_is_replaced(tmp_path: Path, episode: EpisodeSpec) -> None:
    """It runs, but hangs: a controller whose command waits for ever, and does not listen to signals either."""
    code = (
        "import signal, sys; [signal.signal(n, signal.SIG_IGN) for n in (2, 15)]; import rclpy; rclpy.init();"
        "from geometry_msgs.msg import AccelStamped; node = rclpy.create_node('hangs');"
        "p = node.create_publisher(AccelStamped, '/ego/acceleration_command', 10); signal.pause()"
    )
    options = GraphOptions(controller_command=shlex.join([sys.executable, "-c", code]), startup_timeout=3.0)
    with whole_graph(tmp_path, options) as (evaluator, token):
        hanging = of_node(token, "'hangs'")
        while kind_of((log := evaluator.run_episode(episode)).reason) == AbortKind.NOT_STARTED:
            pass  # it was not there yet
        assert log.outcome == Outcome.ABORTED
        assert kind_of(log.reason) == AbortKind.NO_ANSWER
        assert of_node(token, "'hangs'") != hanging


@contextmanager
def graph(context: ForkServerContext, domain: int, folder: Path) -> Iterator[Evaluator]:
    modules = (SIMULATOR, CONTROLLER, ADVERSARY)
    nodes = [start_node(context, module, folder / module, domain) for module in modules]
    with running(*nodes), evaluator(own_world=True) as node:
        yield node


def test_what_is_lost_all_the_same_is_said_and_soon(context, domain, tmp_path, replay, monkeypatch):
    monkeypatch.setattr(evaluator_module, "_LOST", 1.0)
    with graph(context, domain, tmp_path) as node:
        keep, stamps = node._samples.add, list[int]()

        def loses_the_third(stamp: int, state: CarState | AdversaryState) -> None:
            if stamp not in stamps:
                stamps.append(stamp)
            if stamps.index(stamp) != 2 or isinstance(
                state, AdversaryState
            ):  # a simulator that waits for a command sends its state again
                keep(stamp, state)

        monkeypatch.setattr(node._samples, "add", loses_the_third)
        begin = time.monotonic()
        log = node.run_episode(replay)
        took = time.monotonic() - begin
    assert log.outcome == Outcome.ABORTED
    assert kind_of(log.reason) == AbortKind.LOST
    assert "the episode ended, and 1 of its " in log.reason
    assert took < PATIENCE


def test_another_simulator_is_not_held_to_the_laws_of_this_world(replay: EpisodeSpec) -> None:
    """SKD has started either: what follows from the seed is what the simulator that was asked for gives."""
    log = run_episode(replay)
    car = log.car.copy()
    car[2, 3] += 0.2
    other = dataclasses.replace(log, car=car)
    said = refuted(other, own_world=True)
    assert "the car's speed at tick 2" in said
    elsewhere = dataclasses.replace(replay, simulator="metadrive")
    assert refuted(dataclasses.replace(other, episode=elsewhere), own_world=True) is None


def test_a_publisher_whose_process_has_died_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where of the node that died again and again nothing else is left; and where processes are not seen, it is.

    Fast DDS writes vendor, host and process into the first six bytes of a GUID.
    """

    def endpoint(name: str, process: int, host: int = 1) -> SimpleNamespace:
        gid = [1, 15, host, 0, process & 0xFF, process >> 8 & 0xFF, *(18 * [0])]
        return SimpleNamespace(
            node_namespace="/", node_name=name, endpoint_gid=gid, topic_type="any/msg/Any", qos_profile=None
        )

    living, dead = os.getppid(), subprocess.Popen(["true"])
    dead.wait()
    found = {"/parameter_events": [endpoint("ours", os.getpid())], "/topic": []}
    node: Any = SimpleNamespace(
        get_publishers_info_by_topic=found.__getitem__,
        resolve_topic_name=lambda topic: topic,
        get_fully_qualified_name=lambda: "/ours",
    )
    monkeypatch.setattr(diagnosis, "_seen", set())
    found["/topic"] = [endpoint("car", dead.pid), endpoint("car", dead.pid)]
    assert len(diagnosis.living_publishers(node, "/topic")) == 2, "processes of others may not be seen here"
    found["/parameter_events"].append(endpoint("car", living))
    assert not diagnosis.living_publishers(node, "/topic")
    found["/parameter_events"].pop()
    assert not diagnosis.living_publishers(node, "/topic"), "they have been seen"
    found["/topic"].append(endpoint("far", dead.pid, host=2))
    assert [one.name for one in diagnosis.living_publishers(node, "/topic")] == ["/far"]


def test_a_forked_process_leaves_the_nodes_of_its_parent_alone() -> None:
    context = Context()
    rclpy.init(context=context)
    node = rclpy.create_node("forgotten", context=context)
    vars(node)["itself"] = node  # so that only the garbage collector takes it down
    del node
    if (child := os.fork()) == 0:
        gc.collect()
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    rclpy.shutdown(context=context)
