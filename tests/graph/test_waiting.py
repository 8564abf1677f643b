"""Why a command does not come: each cause against a graph in which the fault was made."""

import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import pytest
import rclpy
from common import wait_until
from geometry_msgs.msg import AccelStamped, PoseStamped, Twist
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from skd_evaluator.ros import stack as stack_module
from skd_evaluator.ros.stack import FirstCommands
from skd_sim.errors import AssessmentError
from skd_sim.ros.diagnosis import Awaited, Evidence, Heard, diagnose
from skd_sim.ros.support import STREAM

START = 7_000_000_000
SECOND = 10**9
COMMANDS = Awaited("/ego/acceleration_command", "geometry_msgs/msg/AccelStamped")
Make = Callable[[Node], Any]


class Graph(NamedTuple):
    """A node that watches and publishes states, and one of others."""

    watcher: Node
    stack: Node
    executor: SingleThreadedExecutor


@pytest.fixture
def graph(domain: int) -> Iterator[Graph]:
    theirs = rclpy.Context()  # one participant has one type a topic
    rclpy.init(args=[], context=theirs)
    watcher, stack = rclpy.create_node("watcher"), rclpy.create_node("stack", context=theirs)
    watcher.create_publisher(Odometry, "ego/odometry", STREAM)
    watcher.create_publisher(Odometry, "adversary/odometry", STREAM)
    watcher.create_publisher(LaserScan, "ego/scan", STREAM)
    watcher.create_publisher(Clock, "/clock", STREAM)
    executor = SingleThreadedExecutor()
    executor.add_node(watcher)
    yield Graph(watcher, stack, executor)
    executor.shutdown()
    for node in (watcher, stack):
        node.destroy_node()
    rclpy.try_shutdown(context=theirs)


def listens(kind: type, topic: str, quality: QoSProfile | int = 10) -> Make:
    return lambda node: node.create_subscription(kind, topic, lambda _message: None, quality)


def publishes(kind: type, topic: str = COMMANDS.topic, quality: QoSProfile | int = 10) -> Make:
    return lambda node: node.create_publisher(kind, topic, quality)


def stamped(nanoseconds: int) -> AccelStamped:
    message = AccelStamped()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(nanoseconds, SECOND)
    return message


BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
KEPT = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
HEARS, COMMANDS_IT = listens(Odometry, "/ego/odometry"), publishes(AccelStamped)
FAULTS: dict[str, tuple[tuple[Make, ...], str, dict[str, Any]]] = {  # whose names begin with the cause
    "wrong type": ((HEARS, publishes(Twist)), "-p command_type:=twist -p quiet_time:=0.1", {}),
    "quality of service": (
        (HEARS, publishes(AccelStamped, quality=BEST_EFFORT)),
        "qos_overrides./ego/acceleration_command.publisher.reliability",
        {"newest": START},  # it answers as it should, and the simulator hears nothing of it
    ),
    "subscription of another type": (
        (COMMANDS_IT, listens(PoseStamped, "/ego/odometry")),
        "listens to /ego/odometry for geometry_msgs/msg/PoseStamped, it has nav_msgs/msg/Odometry",
        {},
    ),
    "subscription with another quality of service": (
        (COMMANDS_IT, listens(Odometry, "/ego/odometry", KEPT)),
        "/ego/odometry with a durability that is not offered",
        {},
    ),
    "stamp of zero": ((HEARS, COMMANDS_IT), "-p quiet_time:=0.1, or --pacing real_time", {"newest": 0}),
    "stamp of the wall clock": ((HEARS, COMMANDS_IT), "set use_sim_time:=true", {"newest": 1_700_000_000 * SECOND}),
    "stamp of another state": ((HEARS, COMMANDS_IT), "their stamps lag by 3 s: ", {"newest": START - 3 * SECOND}),
    "no laser": (
        (COMMANDS_IT, listens(LaserScan, "/ego/scan")),
        "the scenario has no section sensor",
        {"senses": False},
    ),
    "wrong topic": (
        (HEARS, publishes(Twist, "/cmd_vel")),
        "messages of /stack arrive on /cmd_vel (geometry_msgs/msg/Twist), and no node listens there: "
        "-p command_topic:=/cmd_vel -p command_type:=twist -p quiet_time:=0.1",
        {"newest": None, "on": "/cmd_vel"},
    ),
    "hears nothing of the pedestrian": (
        (COMMANDS_IT, HEARS, listens(Odometry, "/obstacle")),
        "/stack listens to /obstacle, where no node publishes: remap it (-r obstacle:=/adversary/odometry)",
        {},
    ),
    "hears nothing of either": (
        (COMMANDS_IT, listens(Odometry, "/obstacle"), listens(Odometry, "/odom")),
        "/stack listens to /odom and /obstacle, where no node publishes: "
        "remap it (-r odom:=/ego/odometry -r obstacle:=/adversary/odometry)",
        {},
    ),
    "hears nothing of the car": (
        (COMMANDS_IT, listens(Odometry, "/odom"), listens(Odometry, "/adversary/odometry")),
        "/stack listens to /odom, where no node publishes: remap it (-r odom:=/ego/odometry)",
        {},
    ),
    "perhaps wrong topic": ((HEARS, publishes(Twist, "/cmd_vel")), "-p command_topic:=/cmd_vel", {}),
    "perhaps remapped": ((HEARS, COMMANDS_IT, listens(PoseStamped, "/goal")), "/stack listens to /goal", {}),
    "follows the clock": ((HEARS, COMMANDS_IT, listens(Clock, "/clock")), "-p quiet_time:=0.1", {}),
    "silent": ((HEARS, COMMANDS_IT), "listens to /ego/odometry, but has published nothing on /ego/", {}),
    "silent, and only listens": ((HEARS,), "/ego/acceleration_command; nodes that are not SKD's: /stack", {}),
}


@pytest.mark.parametrize("name", FAULTS)
def test_the_cause_is_found_and_what_mends_it_is_said(graph: Graph, name: str) -> None:
    parts, said, shown = FAULTS[name]
    for make in parts:
        make(graph.stack)
    heard = {}
    if "newest" in shown:
        heard = {shown.get("on", COMMANDS.topic): Heard(count=1, newest=shown["newest"])}
    given = {key: value for key, value in shown.items() if key in ("by_stamp", "senses")}

    def found() -> bool:
        evidence = Evidence(graph.watcher, COMMANDS, START, heard=heard, **given)
        diagnosis = diagnose(evidence)
        return name.startswith(diagnosis.cause) and said in diagnosis.text and not evidence.answered

    wait_until(found, said)


def test_a_managed_node_may_not_be_active(graph: Graph) -> None:
    node = LifecycleNode("planner")
    try:
        wait_until(lambda: "-p lifecycle_nodes:=/planner" in diagnose(Evidence(graph.watcher, COMMANDS, START)).text)
    finally:
        node.destroy_node()


def test_nobody_is_there(graph: Graph) -> None:
    graph.stack.destroy_node()
    wait_until(lambda: "no node but SKD's own" in diagnose(Evidence(graph.watcher, COMMANDS, START)).text)
    walks = Awaited("/adversary/velocity_command", "geometry_msgs/msg/TwistStamped")
    assert diagnose(Evidence(graph.watcher, walks, START)).cause == "no adversary"


def test_a_wait_in_vain_is_given_up(graph: Graph, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the cause is certain; times are shorter here, in the same proportion."""
    for name in ("_LOOK_EVERY", "_SAY_AFTER", "_HINT_AFTER", "_SAY_AGAIN", "_CERTAIN_AFTER"):
        monkeypatch.setattr(stack_module, name, 0.1 * getattr(stack_module, name))
    publisher = COMMANDS_IT(graph.stack)
    lines: list[str] = []
    commands = FirstCommands(graph.watcher, COMMANDS, lines.append)
    commands.begin(START)
    begin = time.monotonic()

    def look() -> bool:
        publisher.publish(stamped(0))
        graph.executor.spin_once(timeout_sec=0.02)
        commands.look(state_came=True)
        return len(lines) > 1 and time.monotonic() - begin > 3.0

    with pytest.raises(AssessmentError, match=r"the car controller is not heard: commands come, .*quiet_time"):
        wait_until(look, "the end")
    assert time.monotonic() - begin < 5.0
    assert lines[-1].startswith(f"waiting for {COMMANDS.topic} (")
    commands.end()
    assert not list(graph.watcher.subscriptions)
