"""Controllers that do what no node should."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence

from fake_nodes import run
from geometry_msgs.msg import AccelStamped, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node

COMMANDS = "/ego/acceleration_command"
ANSWERS = {"twice": (0.0, -5.0), "echo": (0.0, 0.0), "nan": (math.nan,)}  # to a tick, m/s²


class Hostile(Node):
    """Answers the car's odometry in a way of its own."""

    def __init__(self, kind: str) -> None:
        super().__init__(f"hostile_{kind}")
        self._kind = kind
        topic = {"patient": "/adversary/velocity_command"}.get(kind, COMMANDS)
        self._type = TwistStamped if kind == "patient" else AccelStamped
        self._publisher = self.create_publisher(self._type, topic, 10)
        self._heard = 0
        self._stamps: list[tuple[int, int]] = []
        self.create_subscription(Odometry, "/ego/odometry", self._on_odometry, 10)

    def _on_odometry(self, odometry: Odometry) -> None:
        self._heard += 1
        if self._kind == "patient":
            self._stamps.append((odometry.header.stamp.sec, odometry.header.stamp.nanosec))
            first = self._stamps[-1] == self._stamps[0]
            for _ in range(2 * (self._heard > 1) if first else 1):
                self._publisher.publish(TwistStamped(header=odometry.header))
            return
        for value in ANSWERS.get(self._kind, (0.0,)):
            message = AccelStamped(header=odometry.header)
            if self._kind == "stamps":
                message.header.stamp.nanosec += 1
            message.accel.linear.x = value
            self._publisher.publish(message)


def main(args: Sequence[str]) -> int:
    """Run the node that the first argument names."""
    return run(lambda: Hostile(args[0]), args)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
