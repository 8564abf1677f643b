"""Asks for one speed upon every odometry message: the planner of a stack whose safety node is to be assessed.

    python3 constant_speed.py --ros-args -p speed:=8.333 -p ackermann:=true -r command:=/drive

It publishes geometry_msgs/TwistStamped, or ackermann_msgs/AckermannDriveStamped, with the odometry's stamp, after the
time that a planner takes (`thinking_time`, s of wall time). In lockstep that lets the scan of the same moment arrive
first at whoever combines the two. It keeps no clock of its own, so simulated time may stand still or jump.
"""

from __future__ import annotations

import contextlib
import time

import rclpy
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node


class ConstantSpeed(Node):
    """Never brakes: that is left to who listens."""

    def __init__(self) -> None:
        """Make the one message that is published again and again."""
        super().__init__("constant_speed")
        speed = float(self.declare_parameter("speed", 25.0 / 3.0).value)  # m/s
        self.thinking_time = float(self.declare_parameter("thinking_time", 0.01).value)
        if self.declare_parameter("ackermann", False).value:
            from ackermann_msgs.msg import AckermannDriveStamped

            self.message = AckermannDriveStamped()
            self.message.drive.speed = speed
        else:
            self.message = TwistStamped()
            self.message.twist.linear.x = speed
        self.publisher = self.create_publisher(type(self.message), "command", 1)
        self.create_subscription(Odometry, "/ego/odometry", self.on_odometry, 1)

    def on_odometry(self, odometry: Odometry) -> None:
        """Ask for the speed again."""
        time.sleep(self.thinking_time)
        self.message.header.stamp = odometry.header.stamp
        self.publisher.publish(self.message)


def main() -> None:
    """Run until the launch ends."""
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(ConstantSpeed())


if __name__ == "__main__":
    main()
