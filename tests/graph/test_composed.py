"""Simulator and adversary in the evaluator's process: the same bits and messages, the same ends."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import threading
from array import array
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import rclpy
from common import new_domain, wait_until
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import AccelStamped, TwistStamped
from graph_support import assert_same_log, pids_with, whole_graph
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from rosbags.highlevel import AnyReader
from rosgraph_msgs.msg import Clock
from skd_evaluator.assessment.options import GraphOptions
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.errors import AssessmentError
from skd_msgs.msg import Episode as EpisodeMsg
from skd_msgs.msg import EpisodeResult
from skd_sim.ros import support
from skd_sim.ros.commands import message_class
from skd_sim.ros.from_messages import from_stamp
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Outcome
from skd_sim.world.timing import NANOSECONDS
from tf2_msgs.msg import TFMessage

HEARD = {
    support.CLOCK: Clock,
    support.TF: TFMessage,
    support.EGO_ODOMETRY: Odometry,
    support.ADVERSARY_ODOMETRY: Odometry,
    support.ACCELERATION_COMMAND: AccelStamped,
    support.VELOCITY_COMMAND: TwistStamped,
    support.EPISODE_RESULT: EpisodeResult,
    support.EPISODE: EpisodeMsg,
}
EVERY = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
RUNS, IDS = itertools.count(), itertools.count(1 << 20)
_ANSWERS = (support.ACCELERATION_COMMAND, support.VELOCITY_COMMAND)
Told = dict[str, list[tuple[int, str]]]


@contextlib.contextmanager
def somebody(domain: int) -> Iterator[Any]:
    """Give a node that is not of the graph."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context, domain_id=domain)
    node = rclpy.create_node("somebody", context=context)
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.try_shutdown(context=context)


@contextlib.contextmanager
def listening(domain: int) -> Iterator[Told]:
    """Give what a node that is not of the graph hears, by topic, as far as the clock does not decide it."""
    told: Told = defaultdict(list)
    ended = threading.Event()
    with somebody(domain) as node:
        executor = SingleThreadedExecutor(context=node.context)
        executor.add_node(node)

        def listen(topic: str, kind: type) -> None:
            latched = topic == support.EPISODE
            node.create_subscription(
                kind,
                topic,
                lambda message: told[topic].append((when(message), timeless(message))),
                EVERY if latched else support.STREAM,
            )

        def spin() -> None:
            while not ended.is_set():
                executor.spin_once(timeout_sec=0.05)

        for topic, kind in HEARD.items():
            listen(topic, kind)
        thread = threading.Thread(target=spin)
        thread.start()
        try:
            yield told
        finally:
            ended.set()
            thread.join()
            executor.shutdown()


def when(message: Any) -> int:
    """Return a message's own time, ns."""
    if isinstance(message, TFMessage):
        message = message.transforms[0]
    return from_stamp(message.clock if isinstance(message, Clock) else message.header.stamp)


def timeless(message: Any) -> str:
    """Return all that a message says, but how long somebody took and the campaign's name, which is another each time.

    Its bytes have gaps, in which anything may be.
    """
    if hasattr(message, "campaign"):
        message.campaign = ""
    if isinstance(message, EpisodeResult):
        message.command_ages, message.greatest_delay = array("f"), 0.0
    return repr(message)


class Ran(NamedTuple):
    """A graph's episodes, the messages that somebody heard of them, and those in each bag."""

    logs: list[EpisodeLog]
    heard: Told
    bags: list[Told]


def has_come(told: Told, stamp: int) -> bool:
    """Return whether something from a stamp (ns) on has come on each topic."""
    return all(any(time >= stamp for time, _ in [*told[topic]]) for topic in HEARD)


def run(evaluator: Any, domain: int, bags: Path, episodes: list[EpisodeSpec], begin: int) -> Ran:
    """Run episodes with a listener, who hears all topics by then, from a stamp (ns) on; the last is not looked at."""
    with listening(domain) as told:

        def all_heard() -> bool:
            evaluator.run_episode(dataclasses.replace(episodes[0], episode_id=episodes[0].episode_id + next(IDS)))
            return has_come(told, evaluator._key.start)

        wait_until(all_heard, "all publishers")
        evaluator._next_start = begin
        logs = [evaluator.run_episode(one) for one in episodes]
        last = evaluator._key.start
        # Each topic is heard in its order: who has heard of the last episode has heard all of those before.
        wait_until(lambda: has_come(told, last), "the last messages")
        heard = {topic: [one for one in messages if begin <= one[0] < last] for topic, messages in told.items()}
    contents: list[Told] = []
    for log in logs[:-1]:
        (path,) = bags.glob(f"*_{log.episode.episode_id:016x}")
        content: Told = defaultdict(list)
        with AnyReader([path]) as reader:
            for connection, logged, data in reader.messages():
                message = deserialize_message(data, message_class(connection.msgtype))
                content[connection.topic].append((logged, timeless(message)))
        contents.append(content)
    return Ran(logs[:-1], heard, contents)


def answers(told: Told, topic: str) -> set[tuple[int, str]]:
    """Return what was said on a topic, but for answers to a last state, for which nobody waits."""
    ends = {time for name, said in told.items() if name.endswith(support.EPISODE_RESULT) for time, _ in said}
    return {one for one in told[topic] if not (topic.endswith(_ANSWERS) and one[0] in ends)}


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
    """In process, composed and separate are the same, and who listens hears and records the same."""
    lines = " ".join(pids_with(graph.token).values())
    assert "car_controller" in lines
    assert not any(name in lines for name in ("vehicle_simulator", "adversary"))
    periods = dataclasses.replace(replay.scenario, control_period=0.1)  # the car decides between ticks, too
    third = dataclasses.replace(replay, scenario=periods, episode_id=replay.episode_id + 1)
    number_of_run = next(RUNS)  # if this test is run again, names of bags and stamps are taken
    begin = (number_of_run + 1) * 10_000 * NANOSECONDS
    episodes = [
        dataclasses.replace(one, episode_id=one.episode_id + 100 * number_of_run + number)
        for number, one in enumerate((episode, replay, third, episode))
    ]
    composed = run(graph.evaluator, graph.domain, graph.folder / "bags", episodes, begin)
    domain, options = new_domain(), GraphOptions(nodes="separate")
    with whole_graph(tmp_path, options, record_to=tmp_path / "bags", domain=domain) as (evaluator, token):
        assert all(name in " ".join(pids_with(token).values()) for name in ("vehicle_simulator", "adversary"))
        separate = run(evaluator, domain, tmp_path / "bags", episodes, begin)
    for one, left, right in zip(episodes[:-1], composed.logs, separate.logs, strict=True):
        assert left.outcome != Outcome.ABORTED
        assert_same_log(left, right)
        assert_same_log(left, run_episode(one))
    for left, right in zip([composed.heard, *composed.bags], [separate.heard, *separate.bags], strict=True):
        assert set(left) == set(right)
        for topic in left:  # which topic is first is chance; tick 0 may be repeated
            assert answers(left, topic) == answers(right, topic), topic
    assert {topic.lstrip("/") for topic in composed.heard} == {topic.lstrip("/") for topic in HEARD}


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

        for kind, topic in ((Odometry, support.EGO_ODOMETRY), (EpisodeMsg, support.EPISODE)):
            said = f"2 nodes publish /{topic}, one may: /evaluator and /somebody; end all but one"
            with pytest.raises(AssessmentError, match=said):
                run_beside(kind, topic)
