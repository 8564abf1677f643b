"""The car's start pose on `/initialpose`, as RViz sends it: localizations begin anew from it."""

from __future__ import annotations

import math

from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.node import Node

from skd_sim.options.frames import MAP_FRAME
from skd_sim.ros.support import LATCHED
from skd_sim.ros.to_messages import to_stamp
from skd_sim.world.state import CarState

INITIAL_POSE = "initialpose"
_X, _Y, _YAW = 0, 7, 35  # on the diagonal of a covariance of 6 × 6, row by row
_VARIANCE = 1e-6  # m² and rad²: it is exact, and zero would say that it is not known


class InitialPose:
    """Publishes where the car starts; a node that subscribes while an episode runs gets it, too."""

    def __init__(self, node: Node) -> None:
        """Make the topic."""
        self._publisher = node.create_publisher(PoseWithCovarianceStamped, INITIAL_POSE, LATCHED)

    def publish(self, car: CarState, stamp: int) -> None:
        """Publish the pose with a stamp (ns)."""
        message = PoseWithCovarianceStamped()
        message.header.stamp = to_stamp(stamp)
        message.header.frame_id = MAP_FRAME
        pose = message.pose.pose
        pose.position.x, pose.position.y = car.x, car.y
        pose.orientation.z, pose.orientation.w = math.sin(0.5 * car.heading), math.cos(0.5 * car.heading)
        for place in (_X, _Y, _YAW):
            message.pose.covariance[place] = _VARIANCE
        self._publisher.publish(message)
