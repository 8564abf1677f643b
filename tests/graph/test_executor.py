"""The executor that keeps its wait set: messages, timers, services, and what changes while it runs."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
from common import new_domain, wait_until
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import serialize_message
from skd_evaluator.errors import AssessmentError
from skd_evaluator.ros.readiness.one_evaluator import OneEvaluator
from skd_msgs.msg import Episode, EpisodeResult
from skd_sim.messages.read_message import read_message
from skd_sim.nodes.executor import LockstepExecutor
from skd_sim.nodes.publishers import publisher_names
from skd_sim.nodes.support import STREAM, listen
from std_msgs.msg import Int32
from std_srvs.srv import Trigger


@pytest.fixture
def context() -> Iterator[Any]:
    made = rclpy.Context()
    rclpy.init(args=[], context=made, domain_id=new_domain())
    yield made
    rclpy.try_shutdown(context=made)


@pytest.fixture
def node(context: Any) -> Iterator[Node]:
    made = rclpy.create_node("node", context=context)
    yield made
    made.destroy_node()


@pytest.fixture
def executor(node: Node) -> Iterator[LockstepExecutor]:
    made = LockstepExecutor(node)
    yield made
    made.shutdown()


def spin_until(executor: LockstepExecutor, condition: Any) -> None:
    def once() -> Any:
        executor.spin_once(timeout_sec=0.01)
        return condition()

    wait_until(once)


def test_what_is_left_comes_when_it_is_taken(node: Node, executor: LockstepExecutor) -> None:
    """Or when nothing else is to do; another subscription does not wait for that."""
    heard: list[int] = []
    publisher = node.create_publisher(Int32, "numbers", 100)
    subscription = node.create_subscription(Int32, "numbers", lambda message: heard.append(message.data), 100)
    executor.leave(subscription)
    spin_until(executor, publisher.get_subscription_count)
    for number in range(50):
        publisher.publish(Int32(data=number))

    def all_are_there() -> bool:
        executor.take(subscription)
        return len(heard) == 50

    wait_until(all_are_there)
    publisher.publish(Int32(data=50))
    spin_until(executor, lambda: len(heard) == 51)
    assert heard == list(range(51))


def test_messages_come_in_their_order(node: Node, executor: LockstepExecutor) -> None:
    heard: list[int] = []
    publisher = node.create_publisher(Int32, "numbers", 100)
    node.create_subscription(Int32, "numbers", lambda message: heard.append(message.data), 100)
    spin_until(executor, publisher.get_subscription_count)
    for number in range(50):
        publisher.publish(Int32(data=number))
    spin_until(executor, lambda: len(heard) == 50)
    assert heard == list(range(50))


def test_topics_share_a_turn(node: Node, executor: LockstepExecutor) -> None:
    """One topic with a long queue does not hold up another."""
    heard: list[str] = []
    publishers = [node.create_publisher(Int32, name, 100) for name in ("a", "b")]
    for name in ("a", "b"):
        node.create_subscription(Int32, name, lambda _message, name=name: heard.append(name), 100)
    spin_until(executor, lambda: all(publisher.get_subscription_count() for publisher in publishers))
    executor.spin_once(timeout_sec=0.0)
    for _ in range(10):
        for publisher in publishers:
            publisher.publish(Int32())
    time.sleep(0.2)  # all are there before the first is taken
    spin_until(executor, lambda: len(heard) == 20)
    assert set(heard[:3]) == {"a", "b"}


def test_subscriptions_come_and_go_in_callbacks(node: Node, executor: LockstepExecutor) -> None:
    heard: list[str] = []
    publisher = node.create_publisher(Int32, "first", 10)
    other = node.create_publisher(Int32, "second", 10)

    def on_first(_message: Any) -> None:
        heard.append("first")
        node.destroy_subscription(first)
        node.create_subscription(Int32, "second", lambda _message: heard.append("second"), 10)

    first = node.create_subscription(Int32, "first", on_first, 10)
    spin_until(executor, publisher.get_subscription_count)
    publisher.publish(Int32())
    spin_until(executor, lambda: heard)
    spin_until(executor, other.get_subscription_count)
    publisher.publish(Int32())
    other.publish(Int32())
    spin_until(executor, lambda: "second" in heard)
    assert heard == ["first", "second"]


def test_timers_run_and_end_when_destroyed(node: Node, executor: LockstepExecutor) -> None:
    ticks: list[float] = []
    begin = time.monotonic()
    timer = node.create_timer(
        0.02, lambda: ticks.append(time.monotonic()), clock=Clock(clock_type=ClockType.STEADY_TIME)
    )
    spin_until(executor, lambda: len(ticks) >= 5)
    assert ticks[4] - begin >= 5 * 0.02
    node.destroy_timer(timer)
    count = len(ticks)
    for _ in range(10):
        executor.spin_once(timeout_sec=0.01)
    assert len(ticks) == count


@pytest.mark.parametrize("busy", [False, True])
def test_services_answer_also_beside_a_stream(context: Any, node: Node, executor: LockstepExecutor, busy: bool) -> None:
    """What has no place in the wait set is looked after all the same: `ros2 param` works during an episode."""
    node.create_service(Trigger, "ask", lambda _request, response: response)
    if busy:  # each message brings the next: there is never nothing to do
        publisher = node.create_publisher(Int32, "loop", 10)
        node.create_subscription(Int32, "loop", publisher.publish, 10)
        spin_until(executor, publisher.get_subscription_count)
        publisher.publish(Int32())
    asker = rclpy.create_node("asker", context=context)
    client = asker.create_client(Trigger, "ask")
    turning = LockstepExecutor(asker)
    try:
        wait_until(client.service_is_ready)
        future = client.call_async(Trigger.Request())

        def both() -> bool:
            executor.spin_once(timeout_sec=0.01)
            turning.spin_once(timeout_sec=0.01)
            return future.done()

        wait_until(both)
        assert future.result() is not None
    finally:
        turning.shutdown()
        asker.destroy_node()


def test_a_time_without_anything_ends(executor: LockstepExecutor) -> None:
    begin = time.monotonic()
    executor.spin_once(timeout_sec=0.15)
    assert time.monotonic() - begin >= 0.15


def test_an_error_in_a_callback_is_not_lost(node: Node, executor: LockstepExecutor) -> None:
    def fail() -> None:
        raise RuntimeError("in a callback")

    node.create_timer(0.01, fail, clock=Clock(clock_type=ClockType.STEADY_TIME))
    with pytest.raises(RuntimeError, match="in a callback"):
        spin_until(executor, lambda: False)


def test_the_end_of_the_context_ends_the_spin(context: Any, executor: LockstepExecutor) -> None:
    threading.Timer(0.2, lambda: rclpy.shutdown(context=context)).start()
    with pytest.raises(ExternalShutdownException):
        executor.spin()


def test_a_node_that_is_never_idle_ends_too(context: Any, node: Node, executor: LockstepExecutor) -> None:
    node.create_timer(0.0, lambda: None, clock=Clock(clock_type=ClockType.STEADY_TIME))  # always ready
    threading.Timer(0.2, lambda: rclpy.shutdown(context=context)).start()
    with pytest.raises(ExternalShutdownException):
        executor.spin()


def test_an_interrupt_ends_the_spin(executor: LockstepExecutor) -> None:
    def interrupted() -> None:
        threading.Timer(0.2, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
        executor.spin()  # on a busy machine the signal may come before it

    with pytest.raises(KeyboardInterrupt):
        interrupted()


def test_a_spin_ends_when_it_is_over(executor: LockstepExecutor) -> None:
    """Also where nothing comes that would wake it."""
    end = time.monotonic() + 0.2
    executor.spin(lambda: time.monotonic() > end)
    assert time.monotonic() > end


def test_what_a_stranger_asks_ends_no_node(context: Any, node: Node, executor: LockstepExecutor) -> None:
    """rclpy's own service raises at a parameter of no known type, and with that the evaluator ended in a traceback."""
    asked = node.create_client(SetParameters, "/node/set_parameters")
    spin_until(executor, asked.service_is_ready)
    odd = asked.call_async(SetParameters.Request(parameters=[Parameter(name="a", value=ParameterValue(type=99))]))
    usual = asked.call_async(SetParameters.Request(parameters=[Parameter(name="a", value=ParameterValue(type=1))]))
    spin_until(executor, usual.done)
    assert not odd.done()


def test_who_asks_and_is_gone_keeps_nobody_from_work(
    node: Node, executor: LockstepExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An answer to them waits for 0.1 s; asked often enough, a node did nothing else."""
    looks: list[float] = []

    def slow(_self: Any, timeout_sec: float | None = None) -> None:
        looks.append(time.monotonic())
        time.sleep(0.1)

    monkeypatch.setattr(SingleThreadedExecutor, "spin_once", slow)
    end = time.monotonic() + 1.0
    executor.spin(lambda: time.monotonic() > end)
    assert len(looks) == 1


def test_bytes_that_are_no_message_are_left_out(node: Node, executor: LockstepExecutor) -> None:
    """Of an episode's result they ended the assessment with a traceback."""
    heard: list[Any] = []
    publisher = node.create_publisher(EpisodeResult, "/result", STREAM)
    listen(node, EpisodeResult, "/result", lambda data: (read_message(data, EpisodeResult),), heard.append)
    spin_until(executor, publisher.get_subscription_count)
    publisher.publish(b"\0\1\0\0" + b"\xff" * 40)
    publisher.publish(EpisodeResult(campaign="c"))
    spin_until(executor, lambda: heard)
    assert [message.campaign for message in heard] == ["c"]


def test_bytes_that_are_no_episode_announce_none(node: Node) -> None:
    announcer = OneEvaluator(node, "c")
    announcer._on_episode(b"\0\1\0\0" + b"\xff" * 40)
    announcer._on_episode(bytes(serialize_message(Episode(campaign="another"))))
    announcer.require()
    announcer._on_episode(bytes(serialize_message(Episode(campaign="c", episode_id=7))))
    with pytest.raises(AssessmentError, match=r"a node that is gone has published /skd/episode, .* of episode 7; end"):
        announcer.require()


def test_of_two_publishers_of_whom_one_is_gone_meanwhile_both_are_counted(node: Node) -> None:
    """A line said that 1 nodes publish what one may."""
    node.create_publisher(Int32, "numbers", 1)
    wait_until(lambda: publisher_names(node, "numbers"))
    assert publisher_names(node, "numbers", least=2) == ["/node", "one that is gone"]
