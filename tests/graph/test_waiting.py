"""What is said while a first command is awaited: each line against a graph in which the fault was made."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
from common import wait_until
from geometry_msgs.msg import AccelStamped, Twist
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from skd_evaluator.ros import stack as stack_module
from skd_evaluator.ros.stack import Awaited, FirstCommands

START = 7_000_000_000
COMMANDS = "/ego/acceleration_command"
ACCELERATIONS = "geometry_msgs/msg/AccelStamped"


@pytest.fixture
def graph(domain: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Node, Node, SingleThreadedExecutor]]:
    """Who watches, and somebody else's stack, in one process; a look is due after tenths of seconds."""
    monkeypatch.setattr(stack_module, "_LISTEN_AFTER", 0.05)
    monkeypatch.setattr(stack_module, "_SAY_EVERY", 0.6)
    watcher, stack = rclpy.create_node("watcher"), rclpy.create_node("stack")
    executor = SingleThreadedExecutor()
    executor.add_node(watcher)
    yield watcher, stack, executor
    executor.shutdown()
    for node in (watcher, stack):
        node.destroy_node()


def said(
    graph: tuple[Node, Node, SingleThreadedExecutor],
    publisher: Any = None,
    message: Any = None,
    *,
    state_came: bool = True,
) -> str:
    """The first line of a wait, while messages are published."""
    watcher, _, executor = graph
    lines: list[str] = []
    commands = FirstCommands(watcher, [Awaited(COMMANDS, ACCELERATIONS)], lines.append)
    commands.begin(START)

    def look() -> list[str]:
        if publisher is not None:
            publisher.publish(message)
        executor.spin_once(timeout_sec=0.02)
        commands.look(state_came=state_came)
        return lines

    wait_until(look, "a line")
    commands.end()
    assert not list(watcher.subscriptions)
    return lines[0]


def stamped(nanoseconds: int) -> AccelStamped:
    message = AccelStamped()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(nanoseconds, 1_000_000_000)
    return message


def test_nobody_is_there(graph: Any) -> None:
    watcher, stack, _ = graph
    stack.destroy_node()
    wait_until(lambda: len(watcher.get_node_names()) == 1)
    assert said(graph) == (
        f"waiting for {COMMANDS} (0.6 s): nobody publishes on {COMMANDS}; there is no node on the graph but SKD's own"
    )


def test_no_simulator(graph: Any) -> None:
    assert said(graph, state_came=False) == ("waiting for /ego/odometry (0.6 s): nobody publishes on /ego/odometry")


def test_another_topic_and_type(graph: Any) -> None:
    publisher = graph[1].create_publisher(Twist, "/cmd_vel", 10)
    assert said(graph, publisher, Twist()).endswith(
        f"nobody publishes on {COMMANDS}, but messages of /stack arrive on /cmd_vel (geometry_msgs/msg/Twist), and "
        "nobody listens there: -p command_topic:=/cmd_vel -p command_type:=twist, or remap it"
    )


def test_another_type(graph: Any) -> None:
    publisher = graph[1].create_publisher(Twist, COMMANDS, 10)
    assert said(graph, publisher, Twist()).endswith(
        f"/stack publishes geometry_msgs/msg/Twist on {COMMANDS}, awaited is {ACCELERATIONS}: -p command_type:=twist"
    )


def test_best_effort(graph: Any) -> None:
    quality = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    publisher = graph[1].create_publisher(AccelStamped, COMMANDS, quality)
    assert "publish it reliable" in said(graph, publisher, stamped(START + 1))


@pytest.mark.parametrize(
    ("stamp", "told"),
    [
        (0, "they are not set: copy the odometry's stamp"),
        (1_700_000_000 * 10**9, "they are of the wall clock: set use_sim_time:=true"),
        (START - 3 * 10**9, "they lag by 3 s: "),
        (START + 10**9, "they are 1 s ahead: "),
    ],
)
def test_another_stamp(graph: Any, stamp: int, told: str) -> None:
    publisher = graph[1].create_publisher(AccelStamped, COMMANDS, 10)
    line = said(graph, publisher, stamped(stamp))
    assert f"(0.6 s): commands come, but their stamps are of no use: {told}" in line


def test_a_stack_that_hears_nothing(graph: Any) -> None:
    _, stack, _ = graph
    stack.create_publisher(AccelStamped, COMMANDS, 10)
    stack.create_subscription(Odometry, "/odom", lambda _: None, 10)
    assert said(graph).endswith(
        "/stack is there and has not published yet; /stack listens to /odom, where nobody publishes: remap it"
    )
