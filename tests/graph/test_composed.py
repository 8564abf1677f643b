"""Simulator and adversary in the evaluator's process: the same bits and messages, the same ends."""

import contextlib
import dataclasses
import itertools
from array import array
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import rclpy
from common import new_domain, wait_until
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from graph_support import assert_same_log, pids_with, whole_graph
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.serialization import deserialize_message
from rosbags.highlevel import AnyReader
from skd_evaluator import AssessmentError, run_episode
from skd_evaluator.assessment.options import GraphOptions
from skd_msgs.msg import Episode as EpisodeMsg
from skd_msgs.msg import EpisodeResult
from skd_sim.ros import support
from skd_sim.ros.commands import message_class
from skd_sim.world.episode import NANOSECONDS, EpisodeLog, EpisodeSpec, Outcome

RUNS, IDS = itertools.count(), itertools.count(1 << 20)
_ANSWERS = (f"/{support.Topic.ACCELERATION_COMMAND}", f"/{support.Topic.VELOCITY_COMMAND}")
Content = dict[str, set[tuple[int, str]]]
"""By topic the time (ns) and the text of each message of a bag."""


@contextlib.contextmanager
def somebody(domain: int) -> Iterator[Any]:
    context = rclpy.Context()
    rclpy.init(args=[], context=context, domain_id=domain)
    node = rclpy.create_node("somebody", context=context)
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.try_shutdown(context=context)


def timeless(message: Any) -> str:
    """Return all that a message says, but how long somebody took and the campaign's name, which is another each time.

    Its bytes have gaps, in which anything may be.
    """
    if hasattr(message, "campaign"):
        message.campaign = ""
    if isinstance(message, EpisodeResult):
        message.command_ages, message.greatest_delay = array("f"), 0.0
    return repr(message)


def run(evaluator: Any, bags: Path, episodes: list[EpisodeSpec], begin: int) -> list[tuple[EpisodeLog, Content]]:
    """Run episodes from a stamp (ns) on, when all nodes have found each other; return logs and what their bags hold.

    But for answers to a last state, for which nobody waits.
    """
    evaluator.run_episode(dataclasses.replace(episodes[0], episode_id=episodes[0].episode_id + next(IDS)))
    evaluator._next_start = begin
    found = []
    for log in [evaluator.run_episode(one) for one in episodes]:
        (path,) = bags.glob(f"*_{log.episode.episode_id:016x}")
        content: Content = defaultdict(set)
        with AnyReader([path]) as reader:
            for connection, logged, data in reader.messages():
                message = deserialize_message(data, message_class(connection.msgtype))
                content[connection.topic].add((logged, timeless(message)))
        ends = {time for time, _ in content[f"/{support.Topic.EPISODE_RESULT}"]}
        for topic in _ANSWERS:
            content[topic] = {one for one in content[topic] if one[0] not in ends}
        found.append((log, content))
    return found


class Graph(NamedTuple):
    """A composed graph that tests share, in the order in which they stand here."""

    evaluator: Any
    token: str
    domain: int
    folder: Path


@pytest.fixture(scope="module")
def graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Graph]:
    """A graph whose simulator and adversary are in this process, and which records."""
    folder, domain = tmp_path_factory.mktemp("composed"), new_domain()
    options = GraphOptions(command_timeout=30.0, nodes="composed")
    with whole_graph(folder, options, record_to=folder / "bags", domain=domain) as (evaluator, token):
        yield Graph(evaluator, token, domain, folder)


def test_same_bits_and_messages(graph: Graph, tmp_path: Path, episode: EpisodeSpec, replay: EpisodeSpec) -> None:
    """In process, composed and separate are the same, and so are the messages on each topic, as they are recorded."""
    lines = " ".join(pids_with(graph.token).values())
    assert "car_controller" in lines
    assert not any(name in lines for name in ("vehicle_simulator", "adversary"))
    periods = dataclasses.replace(replay.scenario, control_period=0.1)  # the car decides between ticks, too
    third = dataclasses.replace(replay, scenario=periods, episode_id=replay.episode_id + 1)
    number_of_run = next(RUNS)  # if this test is run again, names of bags and stamps are taken
    begin = (number_of_run + 1) * 10_000 * NANOSECONDS
    episodes = [
        dataclasses.replace(one, episode_id=one.episode_id + 100 * number_of_run + number)
        for number, one in enumerate((episode, replay, third))
    ]
    composed = run(graph.evaluator, graph.folder / "bags", episodes, begin)
    with whole_graph(tmp_path, GraphOptions(nodes="separate"), record_to=tmp_path / "bags") as (evaluator, token):
        assert all(name in " ".join(pids_with(token).values()) for name in ("vehicle_simulator", "adversary"))
        separate = run(evaluator, tmp_path / "bags", episodes, begin)
    for one, (log, content), (other, its) in zip(episodes, composed, separate, strict=True):
        assert log.outcome != Outcome.ABORTED
        assert_same_log(log, other)
        assert_same_log(log, run_episode(one))
        assert content == its


def test_diagnostics_say_how_the_campaign_goes(graph: Graph, episode: EpisodeSpec) -> None:
    heard: list[DiagnosticArray] = []
    with somebody(graph.domain) as node:
        node.create_subscription(DiagnosticArray, "/diagnostics", heard.append, 10)
        executor = SingleThreadedExecutor(context=node.context)
        executor.add_node(node)

        def some() -> list[DiagnosticArray]:
            number = episode.episode_id + next(IDS)
            graph.evaluator.run_episode(dataclasses.replace(episode, episode_id=number))
            executor.spin_once(timeout_sec=0.2)
            return heard

        car, running = wait_until(some, "/diagnostics")[0].status
        executor.shutdown()
    assert (car.name, car.level, car.message) == ("skd: car controller", DiagnosticStatus.OK, "answers")
    values = {one.key: one.value for one in running.values}
    assert values["mode"] == "kamikaze"
    assert values["aborted episodes"] == "0"
    assert int(values["episode"]) > episode.episode_id


def test_somebody_else_who_speaks(graph: Graph, episode: EpisodeSpec) -> None:
    """Whoever publishes what is the nodes' own, is named, although none of them listens to it."""
    evaluator = graph.evaluator
    with somebody(graph.domain) as node:

        def run_beside(kind: type, topic: str) -> EpisodeLog:
            publisher = node.create_publisher(kind, topic, support.STREAM)
            wait_until(lambda: evaluator.count_publishers(topic) == 2, topic)
            try:
                log: EpisodeLog = evaluator.run_episode(
                    dataclasses.replace(episode, episode_id=episode.episode_id + next(IDS))
                )
            finally:
                node.destroy_publisher(publisher)
                wait_until(lambda: evaluator.count_publishers(topic) == 1, topic)
            return log

        for kind, topic in ((Odometry, support.Topic.EGO_ODOMETRY), (EpisodeMsg, support.Topic.EPISODE)):
            said = f"2 nodes publish /{topic}, one may: /evaluator and /somebody; end all but one"
            with pytest.raises(AssessmentError, match=said):
                run_beside(kind, topic)
