"""The adversary as a tracked object of vision_msgs, where that package is installed."""

from __future__ import annotations

from typing import Any

from skd_sim.encounter.road_user import HEIGHT, RoadUser
from skd_sim.messages.to_messages import COVARIANCE_6, to_orientation, to_stamp
from skd_sim.state import AdversaryState

try:
    from vision_msgs.msg import Detection3D, Detection3DArray, ObjectHypothesisWithPose
except ImportError:  # ROS 2's base installation lacks it
    Detection3DArray = None

DETECTIONS: type | None = Detection3DArray
"""Type of the messages; none where the package is missing."""
TRACK = "adversary"
"""Its id in every message."""


def detections(adversary: RoadUser, state: AdversaryState, stamp: int, frame_id: str) -> Any:
    """Return a Detection3DArray with the adversary; its velocity has no place in that message.

    Args:
        adversary: the adversary, whose kind gives the class and whose shape gives the box; a disc's box is as wide as
            the disc.
        state: true state of the adversary.
        stamp: time stamp, ns.
        frame_id: frame in which the state is.
    """
    detection, result = Detection3D(id=TRACK), ObjectHypothesisWithPose()
    result.hypothesis.class_id, result.hypothesis.score = adversary.kind, 1.0
    box, size = detection.bbox.center, detection.bbox.size
    box.position.x, box.position.y, box.position.z = state.x, state.y, 0.5 * HEIGHT
    box.orientation = to_orientation(state.heading)
    radius, half_length, half_width = adversary.shape
    size.x, size.y, size.z = 2.0 * (radius or half_length), 2.0 * (radius or half_width), HEIGHT
    result.pose.pose, result.pose.covariance = box, COVARIANCE_6
    detection.results = [result]
    message = Detection3DArray(detections=[detection])
    for header in (message.header, detection.header):
        header.stamp, header.frame_id = to_stamp(stamp), frame_id
    return message
