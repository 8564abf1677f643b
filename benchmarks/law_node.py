#!/usr/bin/env python3
"""A law of `cars` as a stack of somebody else's: one ROS 2 node, standard messages, nothing else heard.

It answers each pair of odometries that have one stamp, with that stamp, or, with `timer`, commands every so many
seconds of `/clock` by what it heard last. The law is reset once, when the node starts, so it has to be one that keeps
nothing from decision to decision.
"""

from __future__ import annotations

import importlib
import math
import sys

import numpy as np
import rclpy
from geometry_msgs.msg import AccelStamped
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.parameter import Parameter
from skd_sim.encounter.scenario import load_scenario
from skd_sim.state import AdversaryState, CarState


class LawNode(Node):
    """Commands what a law says about the last two odometries."""

    def __init__(self) -> None:
        """Declare parameters and topics."""
        super().__init__("law")
        module, _, name = str(self.declare_parameter("law", "").value).partition(":")
        self._law = getattr(importlib.import_module(module), name)()
        self._law.reset(load_scenario("crossing"), np.random.default_rng(0))
        self._timer = float(self.declare_parameter("timer", 0.0).value)
        self._car: Odometry | None = None
        self._adversary: Odometry | None = None
        self._command = self.create_publisher(AccelStamped, "/ego/acceleration_command", 10)
        self.create_subscription(Odometry, "/ego/odometry", self._on_car, 10)
        self.create_subscription(Odometry, "/adversary/odometry", self._on_adversary, 10)
        if self._timer > 0.0:
            self.set_parameters([Parameter("use_sim_time", value=True)])
            self.create_timer(self._timer, self._on_timer)

    def _on_car(self, message: Odometry) -> None:
        self._car = message
        self._on_state()

    def _on_adversary(self, message: Odometry) -> None:
        self._adversary = message
        self._on_state()

    def _on_state(self) -> None:
        car, adversary = self._car, self._adversary
        if self._timer > 0.0 or car is None or adversary is None or car.header.stamp != adversary.header.stamp:
            return
        self._answer(car, adversary, car.header.stamp)

    def _on_timer(self) -> None:
        if self._car is not None and self._adversary is not None:
            self._answer(self._car, self._adversary, self.get_clock().now().to_msg())

    def _answer(self, car: Odometry, adversary: Odometry, stamp: object) -> None:
        here, there = car.pose.pose, adversary.pose.pose.position
        heading = 2.0 * math.atan2(here.orientation.z, here.orientation.w)
        walking = adversary.twist.twist.linear
        command = AccelStamped()
        command.header.stamp = stamp
        command.accel.linear.x = float(
            self._law.command(
                CarState(here.position.x, here.position.y, heading, car.twist.twist.linear.x),
                AdversaryState(there.x, there.y, walking.x, walking.y),
            )
        )
        self._command.publish(command)


def main() -> int:
    """Run the node until it is told to end."""
    rclpy.init(args=sys.argv)
    node = LawNode()
    node.create_timer(0.2, lambda: None)  # rclpy now and then misses SIGTERM in a wait without end
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
