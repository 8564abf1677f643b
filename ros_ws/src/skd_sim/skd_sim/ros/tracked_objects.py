"""Adversary and others as tracked objects of vision_msgs, where that package is installed."""

from __future__ import annotations

from typing import Any

from skd_sim.ros.to_messages import COVARIANCE_6, to_orientation, to_stamp
from skd_sim.scenario.kinds import height_of
from skd_sim.scenario.road_user import Body
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import RoadUserState, Scene

try:
    from vision_msgs.msg import Detection3D, Detection3DArray, ObjectHypothesisWithPose
except ImportError:  # ROS 2's base installation lacks it
    Detection3DArray = None

DETECTIONS: type | None = Detection3DArray
"""Type of the messages; none where the package is missing."""
TRACK = "adversary"
"""The adversary's id in every message; that of `others[0]` is `other_0`."""


def detections(scenario: Scenario, scene: Scene, stamp: int, frame_id: str) -> Any:
    """Return a Detection3DArray with the adversary and the others; velocities have no place in that message.

    Args:
        scenario: gives kinds, which are the classes, and shapes; the box of a disc is as wide as the disc.
        scene: true states.
        stamp: time stamp, ns.
        frame_id: frame in which the states are.
    """
    found = [_detection(TRACK, scenario.adversary, scene.adversary)]
    for index, (other, state) in enumerate(zip(scenario.others, scene.others, strict=True)):
        found.append(_detection(f"other_{index}", other, state))
    message = Detection3DArray(detections=found)
    for one in (message, *found):
        one.header.stamp, one.header.frame_id = to_stamp(stamp), frame_id
    return message


def _detection(track: str, body: Body, state: RoadUserState) -> Any:
    detection, result = Detection3D(id=track), ObjectHypothesisWithPose()
    result.hypothesis.class_id, result.hypothesis.score = body.kind, 1.0
    height = height_of(body.kind)
    box, size = detection.bbox.center, detection.bbox.size
    box.position.x, box.position.y, box.position.z = state.x, state.y, 0.5 * height
    box.orientation = to_orientation(state.heading)
    radius, half_length, half_width = body.shape
    size.x, size.y, size.z = 2.0 * (radius or half_length), 2.0 * (radius or half_width), height
    result.pose.pose, result.pose.covariance = box, COVARIANCE_6
    detection.results = [result]
    return detection
