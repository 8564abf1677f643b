"""Small nodes of somebody else's: plain rclpy and standard messages, nothing of this project."""

import importlib
import signal
import sys
import threading
from collections.abc import Callable, Sequence

import rclpy
from geometry_msgs.msg import AccelStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import LaserScan


class SpeedController(Node):
    """A car that wants to drive at a constant speed; publishes `/ego/acceleration_command` as a speed target."""

    def __init__(self) -> None:
        super().__init__("speed_controller")
        self._stamped = self.declare_parameter("stamped", True).value
        self._target = self.declare_parameter("target", 5.0).value
        kind = TwistStamped if self._stamped else Twist
        self._publisher = self.create_publisher(kind, "/ego/acceleration_command", 10)
        self.create_subscription(Odometry, "/ego/odometry", self._on_odometry, 10)

    def _on_odometry(self, odometry: Odometry) -> None:
        message = TwistStamped() if self._stamped else Twist()
        if self._stamped:
            message.header = odometry.header
        (message.twist if self._stamped else message).linear.x = self._target
        self._publisher.publish(message)


class ScanBraker(Node):
    """A car with eyes of its own: brakes while anything is within 9 m of its laser. It needs the scan alone."""

    def __init__(self) -> None:
        super().__init__("scan_braker")
        self._publisher = self.create_publisher(AccelStamped, "/ego/acceleration_command", 10)
        self.create_subscription(LaserScan, "/ego/scan", self._on_scan, 10)

    def _on_scan(self, scan: LaserScan) -> None:
        message = AccelStamped(header=scan.header)
        message.accel.linear.x = -3.0 if min(scan.ranges) < 9.0 else 0.0
        self._publisher.publish(message)


class ClockFollower(Node):
    """A car that knows nothing of ticks: it decides by a timer of its own, in the time that `/clock` shows."""

    def __init__(self) -> None:
        super().__init__("clock_follower", parameter_overrides=[Parameter("use_sim_time", value=True)])
        self._y: float | None = None
        self._publisher = self.create_publisher(AccelStamped, "/ego/acceleration_command", 10)
        self.create_subscription(Odometry, "/ego/odometry", self._on_odometry, 10)
        self.create_timer(0.1, self._decide)

    def _on_odometry(self, odometry: Odometry) -> None:
        self._y = odometry.pose.pose.position.y

    def _decide(self) -> None:
        if self._y is None:
            return  # as such nodes do, until they have heard something
        message = AccelStamped()
        message.header.stamp = self.get_clock().now().to_msg()
        message.accel.linear.x = -3.0 if self._y > -9.0 else 0.0
        self._publisher.publish(message)


class VendorController(Node):
    """A car whose commands are of a type of its own: brakes and steers once it is near."""

    def __init__(self) -> None:
        super().__init__("vendor_controller")
        self._kind = importlib.import_module("vendor_control_msgs.msg").Control  # which not every test has
        self._publisher = self.create_publisher(self._kind, "/control/command/control_cmd", 10)
        self.create_subscription(Odometry, "/ego/odometry", self._on_odometry, 10)

    def _on_odometry(self, odometry: Odometry) -> None:
        message = self._kind(stamp=odometry.header.stamp, source="vendor")
        near = odometry.pose.pose.position.y > -9.0
        message.longitudinal.acceleration, message.steering_tire_angle = (-3.0, 0.03) if near else (0.0, 0.0)
        self._publisher.publish(message)


def run(make: Callable[[], Node], args: Sequence[str]) -> int:
    """Run a node until it is told to end.

    rclpy's own thread for signals would shut the context down in the middle of a spin, which then now and then raises.
    """
    rclpy.init(args=list(args), signal_handler_options=SignalHandlerOptions.NO)
    over = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: over.set())
    node = make()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while not over.is_set():
            executor.spin_once(timeout_sec=0.2)
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


def main(args: Sequence[str]) -> int:
    nodes = {"speed": SpeedController, "scan": ScanBraker, "clock": ClockFollower, "vendor": VendorController}
    return run(nodes[args[0]], args)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
