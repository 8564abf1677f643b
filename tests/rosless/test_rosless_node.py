"""Nodes and executors within one process: messages, timers, time, events, services."""

from __future__ import annotations

import threading
import time
from typing import Any

import pytest
from common import PATIENCE
from rosless.clock import Clock
from rosless.context import Context
from rosless.duration import Duration
from rosless.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rosless.exceptions import (
    InvalidTopicNameException,
)
from rosless.executors import SingleThreadedExecutor
from rosless.interfaces.classes import message_class, service_class
from rosless.node import Node
from rosless.parameters.parameter import Parameter
from rosless.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rosless.serialization import deserialize_message, serialize_message
from rosless.task import Future
from rosless.time import ClockType

String = message_class("std_msgs/msg/String")
Int32 = message_class("std_msgs/msg/Int32")
ClockMessage = message_class("rosgraph_msgs/msg/Clock")
LONG = 30.0  # s: more than a busy machine adds to a fraction of a second, less than a wrong unit makes of it
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def spin_until(executor: SingleThreadedExecutor, condition: Any, timeout: float = PATIENCE) -> bool:
    end = time.monotonic() + timeout
    while not condition() and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.05)
    return bool(condition())


def test_messages_arrive_in_order(node: Node, executor: SingleThreadedExecutor) -> None:
    got: list[int] = []
    publisher = node.create_publisher(Int32, "numbers", 100)
    subscription = node.create_subscription(Int32, "/ns/numbers", lambda message: got.append(message.data), 100)
    for number in range(50):
        publisher.publish(Int32(data=number))
    assert spin_until(executor, lambda: len(got) == 50)
    assert got == list(range(50))
    assert (publisher.get_subscription_count(), subscription.get_publisher_count()) == (1, 1)
    assert publisher.topic_name == subscription.topic_name == "/ns/numbers"
    assert publisher.wait_for_all_acked(Duration(seconds=PATIENCE))


def test_spin_once_runs_one_callback(node: Node, executor: SingleThreadedExecutor) -> None:
    got: list[int] = []
    publisher = node.create_publisher(Int32, "numbers", 10)
    node.create_subscription(Int32, "numbers", lambda message: got.append(message.data), 10)
    for number in range(3):
        publisher.publish(Int32(data=number))
    counts = []
    while len(got) < 3:
        executor.spin_once(timeout_sec=PATIENCE)
        counts.append(len(got))
    assert [count for count in counts if count] == [1, 2, 3]
    started = time.monotonic()
    executor.spin_once(timeout_sec=0.0)
    executor.spin_once(timeout_sec=0.15)
    assert 0.1 < time.monotonic() - started < LONG


def test_raw_subscriptions_and_message_info(node: Node, executor: SingleThreadedExecutor) -> None:
    got: list[Any] = []
    publisher = node.create_publisher(String, "text", 10)
    node.create_subscription(String, "text", got.append, 10, raw=True)
    node.create_subscription(String, "text", lambda message, info: got.append(info), 10)
    publisher.publish(serialize_message(String(data="hello")))
    assert spin_until(executor, lambda: len(got) == 2)
    raw = next(item for item in got if isinstance(item, bytes))
    info = next(item for item in got if isinstance(item, dict))
    assert deserialize_message(raw, String).data == "hello"
    assert abs(info["source_timestamp"] - time.time_ns()) < 10 * 10**9
    with pytest.raises(RuntimeError, match="callback"):
        node.create_subscription(String, "text", lambda: None, 10)


def test_wrong_messages_are_refused(node: Node) -> None:
    publisher = node.create_publisher(Int32, "numbers", 10)
    with pytest.raises(TypeError):
        publisher.publish(String())
    with pytest.raises(TypeError, match="'data' must be an int"):
        publisher.publish(Int32(data=1.0))
    with pytest.raises(TypeError):
        node.create_publisher(dict, "numbers", 10)
    with pytest.raises(TypeError, match="QoSProfile or int"):
        node.create_publisher(Int32, "numbers", "10")
    with pytest.raises(ValueError, match="depth"):
        node.create_publisher(Int32, "numbers", -1)
    with pytest.raises(InvalidTopicNameException):
        node.create_publisher(Int32, "not valid", 10)
    with pytest.raises(NotImplementedError, match="content_filter"):
        node.create_subscription(Int32, "numbers", print, 10, content_filter_options=object())


def test_an_error_in_a_callback_leaves_spin(node: Node, executor: SingleThreadedExecutor) -> None:
    def fail() -> None:
        raise ZeroDivisionError

    node.create_timer(0.01, fail)
    with pytest.raises(ZeroDivisionError):
        executor.spin()


def test_timers(node: Node, executor: SingleThreadedExecutor) -> None:
    calls: list[float] = []
    timer = node.create_timer(
        0.05, lambda: calls.append(time.monotonic()), clock=Clock(clock_type=ClockType.STEADY_TIME)
    )
    started = time.monotonic()
    assert spin_until(executor, lambda: len(calls) == 4)
    assert 0.19 < calls[-1] - started < LONG
    timer.cancel()
    assert timer.is_canceled()
    executor.spin_once(timeout_sec=0.1)
    assert len(calls) == 4
    timer.reset()
    assert timer.time_until_next_call() <= 50_000_000
    assert spin_until(executor, lambda: len(calls) == 5)
    assert node.destroy_timer(timer)
    assert not node.destroy_timer(timer)
    late = node.create_timer(0.01, lambda: calls.append(0.0), autostart=False)
    executor.spin_once(timeout_sec=0.05)
    assert 0.0 not in calls
    assert late.is_canceled()


def test_missed_periods_are_skipped(node: Node, executor: SingleThreadedExecutor) -> None:
    calls: list[float] = []
    node.create_timer(0.02, lambda: calls.append(time.monotonic()))
    time.sleep(0.2)
    end = time.monotonic() + 0.1
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=0.01)
    assert len(calls) <= 7


def test_simulated_time(node: Node, executor: SingleThreadedExecutor, context: Context) -> None:
    simulator = Node("simulator", context=context)
    publisher = simulator.create_publisher(ClockMessage, "/clock", 1)
    ticks: list[int] = []
    node.set_parameters([Parameter("use_sim_time", value=True)])
    clock = node.get_clock()
    assert clock.now().nanoseconds == 0
    node.create_timer(1.0, lambda: ticks.append(clock.now().nanoseconds))

    def show(seconds: float) -> None:
        stamp = int(seconds * 1e9)
        publisher.publish(ClockMessage(clock=message_class("builtin_interfaces/msg/Time")(
            sec=stamp // 10**9, nanosec=stamp % 10**9)))  # fmt: skip
        assert spin_until(executor, lambda: clock.now().nanoseconds == stamp)
        for _ in range(3):
            executor.spin_once(timeout_sec=0.0)

    for seconds in (10.0, 10.5, 11.0, 11.5, 12.0):
        show(seconds)
    assert len(ticks) == 3
    show(1.0)  # the next run of the simulation begins
    assert len(ticks) == 3
    show(2.0)
    assert ticks[-1] == 2_000_000_000
    node.set_parameters([Parameter("use_sim_time", value=False)])
    assert abs(clock.now().nanoseconds - time.time_ns()) < 10**9


def test_rates_and_waiting_for_a_message(node: Node, executor: SingleThreadedExecutor, context: Context) -> None:
    from rosless.wait_for_message import wait_for_message

    stop = threading.Event()

    def spin() -> None:
        try:
            while not stop.is_set():
                executor.spin_once(timeout_sec=0.02)
        finally:
            rate.destroy()  # so that a failure here cannot leave the test asleep

    rate = node.create_rate(50.0, Clock(clock_type=ClockType.STEADY_TIME))
    publisher = node.create_publisher(Int32, "numbers", 1)
    node.create_timer(0.02, lambda: publisher.publish(Int32(data=7)))
    thread = threading.Thread(target=spin)
    thread.start()
    try:
        started = time.monotonic()
        for _ in range(5):
            rate.sleep()
        assert 0.06 < time.monotonic() - started < LONG
        other = Node("other", context=context)
        found, message = wait_for_message(Int32, other, "/ns/numbers", time_to_wait=PATIENCE)
        assert (found, message.data) == (True, 7)
        assert wait_for_message(Int32, other, "/nothing", time_to_wait=0.05) == (False, None)
    finally:
        stop.set()
        thread.join()


def test_guard_conditions_wake_from_another_thread(node: Node, executor: SingleThreadedExecutor) -> None:
    calls: list[int] = []
    guard = node.create_guard_condition(lambda: calls.append(1))
    threading.Timer(0.1, guard.trigger).start()
    executor.spin_once(timeout_sec=1000.0)
    assert calls == [1]
    executor.spin_once(timeout_sec=0.05)
    assert calls == [1]


def test_futures_and_coroutines(node: Node, executor: SingleThreadedExecutor) -> None:
    future = Future()
    threading.Timer(0.1, lambda: future.set_result(3)).start()
    executor.spin_until_future_complete(future, timeout_sec=PATIENCE)
    assert future.result() == 3
    started = time.monotonic()
    executor.spin_until_future_complete(Future(), timeout_sec=0.1)
    assert 0.09 < time.monotonic() - started < LONG
    inner = Future()

    async def wait() -> int:
        return await inner + 1

    task = executor.create_task(wait)
    executor.spin_once(timeout_sec=0.1)
    assert not task.done()
    inner.set_result(1)
    executor.spin_until_future_complete(task, timeout_sec=PATIENCE)
    assert task.result() == 2


def test_transient_local_reaches_a_late_subscription(node: Node, executor: SingleThreadedExecutor) -> None:
    publisher = node.create_publisher(Int32, "latched", LATCHED)
    for number in range(3):
        publisher.publish(Int32(data=number))
    got: list[int] = []
    node.create_subscription(Int32, "latched", lambda message: got.append(message.data), LATCHED)
    assert spin_until(executor, lambda: got)
    assert got == [2]


def test_incompatible_qos_is_reported_on_both_sides(
    node: Node, executor: SingleThreadedExecutor, capfd: pytest.CaptureFixture[str]
) -> None:
    events: list[Any] = []
    node.create_publisher(
        Int32,
        "a",
        qos_profile_sensor_data,
        event_callbacks=PublisherEventCallbacks(incompatible_qos=events.append),
    )
    node.create_subscription(
        Int32, "a", print, 10, event_callbacks=SubscriptionEventCallbacks(incompatible_qos=events.append)
    )
    assert spin_until(executor, lambda: len(events) == 2)
    assert [event.last_policy_kind.name for event in events] == ["RELIABILITY", "RELIABILITY"]
    node.create_publisher(Int32, "b", qos_profile_sensor_data)
    node.create_subscription(Int32, "b", print, 10)
    for _ in range(5):
        executor.spin_once(timeout_sec=0.05)
    text = capfd.readouterr().err
    assert "[WARN]" in text
    assert "New publisher discovered on topic 'b', offering incompatible QoS." in text
    assert "New subscription discovered on topic 'b', requesting incompatible QoS." in text
    assert "Last incompatible policy: RELIABILITY" in text


def test_matched_events(node: Node, executor: SingleThreadedExecutor) -> None:
    events: list[Any] = []
    node.create_publisher(Int32, "a", 10, event_callbacks=PublisherEventCallbacks(matched=events.append))
    subscription = node.create_subscription(Int32, "a", print, 10)
    assert spin_until(executor, lambda: events)
    assert (events[0].current_count, events[0].current_count_change) == (1, 1)
    node.destroy_subscription(subscription)
    assert spin_until(executor, lambda: len(events) == 2)
    assert events[1].current_count == 0


def test_a_type_mismatch_is_reported(
    node: Node, executor: SingleThreadedExecutor, capfd: pytest.CaptureFixture[str]
) -> None:
    node.create_publisher(Int32, "a", 10)
    node.create_subscription(String, "a", print, 10)
    for _ in range(5):
        executor.spin_once(timeout_sec=0.02)
    assert node.count_publishers("a") == 1


def test_services(node: Node, executor: SingleThreadedExecutor) -> None:
    trigger = service_class("std_srvs", "SetBool")

    def answer(request: Any, response: Any) -> Any:
        response.success, response.message = request.data, "done"
        return response

    node.create_service(trigger, "switch", answer)
    client = node.create_client(trigger, "switch")
    assert client.wait_for_service(PATIENCE)
    future = client.call_async(trigger.Request(data=True))
    executor.spin_until_future_complete(future, timeout_sec=PATIENCE)
    assert (future.result().success, future.result().message) == (True, "done")
    assert (node.count_services("switch"), node.count_clients("switch")) == (1, 1)


def test_parameter_services(node: Node, executor: SingleThreadedExecutor, context: Context) -> None:
    node.declare_parameter("speed", 2.5)
    other = Node("asker", context=context)
    executor.add_node(other)

    def call(service: str, name: str, **members: Any) -> Any:
        kind = service_class("rcl_interfaces", service)
        client = other.create_client(kind, f"/ns/car/{name}")
        assert client.wait_for_service(PATIENCE)
        future = client.call_async(kind.Request(**members))
        executor.spin_until_future_complete(future, timeout_sec=PATIENCE)
        return future.result()

    assert call("GetParameters", "get_parameters", names=["speed"]).values[0].double_value == 2.5
    assert list(call("GetParameterTypes", "get_parameter_types", names=["speed"]).types) == [3]
    assert call("DescribeParameters", "describe_parameters", names=["speed"]).descriptors[0].name == "speed"
    assert "speed" in call("ListParameters", "list_parameters").result.names
    results = call("SetParameters", "set_parameters", parameters=[
        Parameter("speed", value=3.5).to_parameter_msg(), Parameter("speed", value="x").to_parameter_msg(),
        Parameter("unknown", value=1).to_parameter_msg()]).results  # fmt: skip
    assert [result.successful for result in results] == [True, False, False]
    assert node.get_parameter("speed").value == 3.5
