"""How long messages take between processes: a round trip of two, and a lap of four in lock step; how nodes start.

Each process runs a plain rclpy node (nav_msgs/Odometry, reliable, depth 10), so the same file measures
rosless or, with ROS 2 sourced, rclpy itself.

    python benchmarks/rosless_roundtrip.py [--laps 5000] [--json]
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

_ROSLESS_SOURCE = Path(__file__).resolve().parents[1] / "rosless" / "src"
_WARM_UP_LAPS = 200
_DISCOVERY = 60.0  # s
_SILENCE = 10.0  # s


def _prepare_rclpy() -> None:
    try:
        import rclpy  # noqa: F401
    except ModuleNotFoundError:
        sys.path.insert(0, str(_ROSLESS_SOURCE))
        import rosless.activate  # noqa: F401


def _relay(index: int) -> None:
    """Pass each message on from link ``index`` to link ``index + 1``."""
    _prepare_rclpy()
    import rclpy
    from nav_msgs.msg import Odometry
    from rclpy.executors import ExternalShutdownException

    rclpy.init(args=[])
    node = rclpy.create_node(f"relay_{index}")
    publisher = node.create_publisher(Odometry, f"/link_{index + 1}", 10)
    node.create_subscription(Odometry, f"/link_{index}", publisher.publish, 10)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


def _drive(relays: int, laps: int) -> dict[str, float]:
    """Send a message round the ring, wait for it, send the next."""
    started = time.perf_counter()
    _prepare_rclpy()
    import rclpy
    from nav_msgs.msg import Odometry

    rclpy.init(args=[])
    node = rclpy.create_node("driver")
    publisher = node.create_publisher(Odometry, "/link_0", 10)
    times: list[float] = []
    message = Odometry()
    sent = 0.0

    def send() -> None:
        nonlocal sent
        message.header.stamp.nanosec = len(times)
        sent = time.perf_counter()
        publisher.publish(message)

    def on_return(returned: Odometry) -> None:
        if returned.header.stamp.nanosec == len(times):
            times.append(time.perf_counter() - sent)
            send()

    subscription = node.create_subscription(Odometry, f"/link_{relays}", on_return, 10)
    startup = time.perf_counter() - started
    while publisher.get_subscription_count() == 0 or subscription.get_publisher_count() == 0:
        time.sleep(0.01)
    executor = rclpy.executors.SingleThreadedExecutor()
    executor.add_node(node)
    end = time.monotonic() + _DISCOVERY
    while not times:  # until the relays know one another, a message may be lost
        send()
        executor.spin_once(timeout_sec=0.5)
        if time.monotonic() > end:
            raise SystemExit(f"no message came back within {_DISCOVERY:g} s")
    while len(times) < laps + _WARM_UP_LAPS:
        done = len(times)
        executor.spin_once(timeout_sec=_SILENCE)
        if len(times) == done and time.perf_counter() - sent > _SILENCE:
            raise SystemExit("the messages stopped")
    micros = sorted(1e6 * value for value in times[_WARM_UP_LAPS:])
    node.destroy_node()
    rclpy.shutdown()
    return {
        "median_us": statistics.median(micros),
        "mean_us": statistics.fmean(micros),
        "p99_us": micros[int(0.99 * len(micros))],
        "min_us": micros[0],
        "node_start_s": startup,
    }


def _measure(relays: int, laps: int, domain: int) -> dict[str, float]:
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
    command = [sys.executable, __file__]
    children = [subprocess.Popen([*command, "--relay", str(index)], env=environment) for index in range(relays)]
    try:
        driver = subprocess.run(
            [*command, "--drive", str(relays), "--laps", str(laps)],
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
            check=True,
            timeout=120,
        )
        return json.loads(driver.stdout)
    finally:
        for child in children:
            child.terminate()
        for child in children:
            child.wait(timeout=10)


def main() -> None:
    """Measure, and print a table or JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--laps", type=int, default=5000, help="laps to measure (default: 5000)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--relay", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--drive", type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.relay is not None:
        _relay(arguments.relay)
        return
    if arguments.drive is not None:
        print(json.dumps(_drive(arguments.drive, arguments.laps)))
        return
    domain = 1 + os.getpid() % 100
    results = {
        "round trip, two processes": _measure(1, arguments.laps, domain),
        "lap, four processes in lock step": _measure(3, arguments.laps, domain),
    }
    if arguments.json:
        print(json.dumps(results, indent=2))
        return
    print(f"{'':34}{'median':>10}{'mean':>10}{'p99':>10}{'min':>10}   (µs)")
    for name, figures in results.items():
        row = "".join(f"{figures[key]:10.0f}" for key in ("median_us", "mean_us", "p99_us", "min_us"))
        print(f"{name:34}{row}")
    starts = ", ".join(f"{figures['node_start_s']:.2f}" for figures in results.values())
    print(f"from the import of rclpy to the node: {starts} s")


if __name__ == "__main__":
    main()
