"""The same car as a ROS 2 node: it hears both odometries and answers with AckermannDriveStamped."""

from __future__ import annotations

import contextlib
import math
import sys

import rclpy
from ackermann_msgs.msg import AckermannDriveStamped
from evasive import BrakesToOtherLane
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from skd_sim.ros.from_messages import from_stamp, odometry_to_adversary, odometry_to_car
from skd_sim.scenario.scenario import load_scenario

WHEELBASE = 2.6  # m
NEW_EPISODE = 500_000_000  # ns without a state: the car is back at its start


class EvasiveNode(Node):
    """Brakes, and changes to the lane to the left."""

    def __init__(self) -> None:
        """Listen to the car and to the road user."""
        super().__init__("evasive")
        self._policy, self._scenario = BrakesToOtherLane(), load_scenario("oncoming_lane")
        self._adversary: Odometry | None = None
        self._ego: Odometry | None = None
        self._answered = -NEW_EPISODE
        self._commands = self.create_publisher(AckermannDriveStamped, "/drive", 10)
        self.create_subscription(Odometry, "/ego/odometry", self._on_ego, 10)
        self.create_subscription(Odometry, "/adversary/odometry", self._on_adversary, 10)

    def _on_ego(self, message: Odometry) -> None:
        self._ego = message
        self._answer()

    def _on_adversary(self, message: Odometry) -> None:
        self._adversary = message
        self._answer()

    def _answer(self) -> None:
        """Answer a state once both halves of it are there; one that is repeated is answered as before."""
        if self._ego is None or self._adversary is None or self._ego.header.stamp != self._adversary.header.stamp:
            return
        stamp = from_stamp(self._ego.header.stamp)
        if stamp != self._answered:
            if abs(stamp - self._answered) >= NEW_EPISODE:
                self._policy.reset(self._scenario, None)
            car, adversary = odometry_to_car(self._ego), odometry_to_adversary(self._adversary)
            acceleration, curvature = self._policy.command(car, adversary)
            self._message = AckermannDriveStamped(header=self._ego.header)
            drive = self._message.drive
            drive.steering_angle = math.atan(WHEELBASE * curvature)
            drive.acceleration = abs(acceleration)
            drive.speed = car.speed if acceleration == 0.0 else 0.0 if acceleration < 0.0 else 50.0
            self._answered = stamp
        self._commands.publish(self._message)


def main() -> int:
    """Run the node until the graph ends."""
    rclpy.init(args=sys.argv)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(EvasiveNode())
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
