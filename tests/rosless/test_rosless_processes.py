"""Graphs of several processes."""

from __future__ import annotations

import signal
from collections.abc import Callable

import pytest
from common import new_domain, wait_until
from rosless_support import Process

Start = Callable[..., Process]

TALKER = """
    import itertools, sys, rclpy
    from std_msgs.msg import Int32
    from rclpy.qos import QoSProfile, QoSReliabilityPolicy as Reliability, QoSDurabilityPolicy
    from rclpy.executors import ExternalShutdownException

    def main():
        rclpy.init()
        node = rclpy.create_node("talker")
        durable = "latched" in sys.argv
        qos = QoSProfile(depth=10,
            durability=QoSDurabilityPolicy.TRANSIENT_LOCAL if durable else QoSDurabilityPolicy.VOLATILE,
            reliability=Reliability.BEST_EFFORT if "lossy" in sys.argv else Reliability.RELIABLE)
        publisher = node.create_publisher(Int32, "numbers", qos)
        if durable:
            publisher.publish(Int32(data=42))
        elif "silent" not in sys.argv:
            count = itertools.count(next((int(word) for word in sys.argv[1:] if word.isdecimal()), 0))
            node.create_timer(0.02, lambda: publisher.publish(Int32(data=next(count))))
        # said from within spin, so that a signal sent then finds it spinning
        def say():
            ready.cancel()
            print("ready", flush=True)
        ready = node.create_timer(0.0, say)
        try:
            rclpy.spin(node)
        except KeyboardInterrupt:
            print("KeyboardInterrupt")
        except ExternalShutdownException:
            print("ExternalShutdownException")
        finally:
            node.destroy_node()
            rclpy.try_shutdown()
    main()
"""

LISTENER = """
    import sys, time, rclpy
    from std_msgs.msg import Int32
    from rclpy.qos import QoSProfile, QoSDurabilityPolicy
    from rclpy.task import Future
    rclpy.init()
    node = rclpy.create_node("listener")
    durability = QoSDurabilityPolicy["TRANSIENT_LOCAL" if "latched" in sys.argv else "VOLATILE"]
    done = Future()
    def on_message(message):
        print("got", message.data, flush=True)
        if not done.done():
            done.set_result(message.data)
    node.create_subscription(Int32, "numbers", on_message, QoSProfile(depth=10, durability=durability))
    print("ready", flush=True)
    wanted = float(sys.argv[1])
    rclpy.spin_until_future_complete(node, done, timeout_sec=wanted)
    print("publishers", node.count_publishers("numbers"), sorted(node.get_node_names()))
    node.destroy_node()
    rclpy.shutdown()
"""


@pytest.mark.parametrize("first", ["talker", "listener"])
def test_either_may_start_first(domain: int, start: Start, first: str) -> None:
    if first == "talker":
        start(TALKER).wait_for_line("ready")
        listener = start(LISTENER, "10")
    else:
        listener = start(LISTENER, "10")
        listener.wait_for_line("ready")
        start(TALKER)
    code, out, err = listener.finish()
    assert code == 0, err
    assert "got" in out
    assert "publishers 1 ['listener', 'talker']" in out


def test_a_late_joiner_gets_what_is_latched(domain: int, start: Start) -> None:
    start(TALKER, "latched").wait_for_line("ready")
    code, out, err = start(LISTENER, "10", "latched").finish()
    assert (code, "got 42" in out) == (0, True), err


def test_domains_do_not_see_each_other(domain: int, start: Start) -> None:
    start(TALKER, ROS_DOMAIN_ID=str(new_domain())).wait_for_line("ready")
    code, out, err = start(LISTENER, "1.0").finish()
    assert code == 0, err
    assert "got" not in out
    assert "publishers 0 ['listener']" in out


def test_discovery_can_be_off(domain: int, start: Start) -> None:
    start(TALKER, ROS_AUTOMATIC_DISCOVERY_RANGE="OFF").wait_for_line("ready")
    _, out, _ = start(LISTENER, "0.7", ROS_AUTOMATIC_DISCOVERY_RANGE="OFF").finish()
    assert "publishers 0 ['listener']" in out


def test_incompatible_qos_is_logged_on_both_sides(domain: int, start: Start) -> None:
    talker = start(TALKER, "lossy")
    talker.wait_for_line("ready")
    _, out, err = start(LISTENER, "1.0").finish()
    assert "got" not in out
    assert "[listener]: New publisher discovered on topic 'numbers', offering incompatible QoS." in err
    talker.signal(signal.SIGINT)
    _, _, err = talker.finish()
    assert "[talker]: New subscription discovered on topic 'numbers', requesting incompatible QoS." in err


@pytest.mark.parametrize(
    ("number", "exception"),
    [(signal.SIGINT, "KeyboardInterrupt"), (signal.SIGTERM, "ExternalShutdownException")],
)
def test_signals_end_a_spin(domain: int, start: Start, number: int, exception: str) -> None:
    # a spin that is not waiting when SIGTERM comes just returns, as rclpy's does: so one that always waits
    talker = start(TALKER, "silent")
    talker.wait_for_line("ready")
    assert wait_until(talker.sleeps)
    talker.signal(number)
    code, out, err = talker.finish()
    assert (code, out.strip(), err) == (0, exception, "")


def test_a_killed_publisher_can_come_back(domain: int, start: Start) -> None:
    listener = start(
        """
        import rclpy
        from std_msgs.msg import Int32
        rclpy.init()
        node = rclpy.create_node("listener")
        node.create_subscription(Int32, "numbers", lambda message: print("got", message.data, flush=True), 10)
        rclpy.spin(node)
        """
    )
    for first in ("1000000", "2000000"):
        talker = start(TALKER, first)
        listener.wait_for_line(f"got {first[0]}")
        talker.kill()


def test_simulated_time_between_processes(domain: int, start: Start) -> None:
    node = start(
        """
        import rclpy
        rclpy.init()
        node = rclpy.create_node("follower")
        def tick():
            print("tick", node.get_clock().now().nanoseconds, flush=True)
        node.create_timer(10.0, tick)
        print("ready", flush=True)
        rclpy.spin(node)
        """,
        "--ros-args",
        "-p",
        "use_sim_time:=true",
    )
    node.wait_for_line("ready")
    start(
        """
        import rclpy
        from rosgraph_msgs.msg import Clock
        rclpy.init()
        node = rclpy.create_node("simulator")
        publisher = node.create_publisher(Clock, "/clock", 1)
        seconds = iter(range(0, 10**6, 5))
        def step():
            message = Clock()
            message.clock.sec = next(seconds)
            publisher.publish(message)
        node.create_timer(0.25, step)  # so slow that a follower who waits for a core misses none
        rclpy.spin(node)
        """
    )
    first = int(node.wait_for_line("tick").split()[1])
    second = int(node.wait_for_line("tick").split()[1])
    assert first % (5 * 10**9) == 0
    assert second - first in (10 * 10**9, 15 * 10**9)


def test_arguments_and_environment_reach_the_node(domain: int, start: Start) -> None:
    program = start(
        """
        import rclpy
        rclpy.init()
        node = rclpy.create_node("car")
        speed = node.declare_parameter("speed", 1.0).value
        print(node.get_fully_qualified_name(), speed, node.resolve_topic_name("odom"))
        node.get_logger().debug("shown")
        rclpy.shutdown()
        """,
        "--ros-args",
        "-r",
        "__ns:=/fleet",
        "--log-level",
        "debug",
        ROSLESS_ARGS="-p speed:=2.5 -r odom:=/ego/odometry",
    )
    code, out, err = program.finish()
    assert code == 0, err
    assert out.strip() == "/fleet/car 2.5 /ego/odometry"
    assert "[DEBUG] [" in err
    assert "[fleet.car]: shown" in err


def test_a_bad_domain_id_ends_the_program_with_one_line(domain: int, start: Start) -> None:
    code, _, err = start("import rclpy; rclpy.init()", ROS_DOMAIN_ID="one").finish()
    assert code == 1
    assert "ROS_DOMAIN_ID must be an integer from 0 to 232, got 'one'" in err.splitlines()[-1]
