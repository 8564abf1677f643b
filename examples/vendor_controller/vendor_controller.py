#!/usr/bin/env python3
"""A car's emergency brake as a vendor might ship it: one ROS 2 node, standard messages, nothing of SKD.

Braking law: from the two odometries it predicts, with constant velocities, when the car's front reaches the
adversary and whether the adversary is then in the car's path. If so, and if that is less than `time_to_collision`
away, it brakes.

It answers each pair of odometries with a command that carries their stamp, and keeps nothing from one pair to the
next: a new episode, a repeated message or a restart need no special care.
"""

import math

import rclpy
from geometry_msgs.msg import AccelStamped
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

PARAMETERS = (  # name, default, lowest, highest, description
    ("time_to_collision", 1.2, 0.1, 10.0, "brake when the predicted collision is nearer than this, s"),
    ("deceleration", 5.0, 0.1, 10.0, "when braking, m/s²"),
    ("front", 2.25, 0.0, 10.0, "front bumper ahead of the odometry's reference point, m"),
    ("rear", 2.25, 0.0, 20.0, "rear bumper behind it, m"),
    (
        "half_path",
        1.4,
        0.1,
        5.0,
        "half the width of the path to keep free, m: half a car, an adversary, a margin",
    ),
)
STANDING = 0.1  # m/s: below it the car needs no brake


class VendorController(Node):
    """Brakes for an adversary that will be in the car's path."""

    def __init__(self) -> None:
        """Declare parameters and topics."""
        super().__init__("vendor_controller")
        for name, default, low, high, description in PARAMETERS:
            limits = [FloatingPointRange(from_value=low, to_value=high, step=0.0)]
            descriptor = ParameterDescriptor(description=description, floating_point_range=limits)
            self.declare_parameter(name, default, descriptor)
        self._car = None
        self._adversary = None
        self._command = self.create_publisher(AccelStamped, "/ego/acceleration_command", 10)
        self.create_subscription(Odometry, "/ego/odometry", self._on_car, 10)
        self.create_subscription(Odometry, "/adversary/odometry", self._on_adversary, 10)

    def _on_car(self, message: Odometry) -> None:
        self._car = message
        self._answer()

    def _on_adversary(self, message: Odometry) -> None:
        self._adversary = message
        self._answer()

    def _answer(self) -> None:
        """Command the car once both odometries of one instant are here; they come in either order."""
        car, adversary = self._car, self._adversary
        if car is None or adversary is None or car.header.stamp != adversary.header.stamp:
            return
        command = AccelStamped()
        command.header.stamp = car.header.stamp
        command.header.frame_id = car.child_frame_id
        command.accel.linear.x = self.acceleration(car, adversary)
        self._command.publish(command)

    def acceleration(self, car: Odometry, adversary: Odometry) -> float:
        """Return the acceleration to command, m/s²."""
        settings = {name: self.get_parameter(name).value for name, *_ in PARAMETERS}
        speed = car.twist.twist.linear.x
        if speed < STANDING:
            return 0.0
        # The adversary as the car sees it: ahead and to the left, position (m) and velocity (m/s).
        orientation = car.pose.pose.orientation
        heading = 2.0 * math.atan2(orientation.z, orientation.w)
        there, here = adversary.pose.pose.position, car.pose.pose.position
        ahead, left = rotated(there.x - here.x, there.y - here.y, -heading)
        walking = adversary.twist.twist.linear
        receding, sideways = rotated(walking.x, walking.y, -heading)
        closing = speed - receding
        if closing <= 0.0 or ahead < -settings["rear"]:
            return 0.0
        # Front and rear pass the adversary between these two times from now; where is it in the meantime?
        begin = max(0.0, (ahead - settings["front"]) / closing)
        end = (ahead + settings["rear"]) / closing
        first, last = sorted((left + sideways * begin, left + sideways * end))
        in_path = first <= settings["half_path"] and last >= -settings["half_path"]
        return -settings["deceleration"] if in_path and begin <= settings["time_to_collision"] else 0.0


def rotated(x: float, y: float, angle: float) -> tuple[float, float]:
    """Return a vector turned by an angle (rad)."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return cosine * x - sine * y, sine * x + cosine * y


def main() -> None:
    """Run the node until it is told to end."""
    rclpy.init()
    node = VendorController()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
