"""The types that are on the wire are those of the bags: rclpy's hashes (REP 2011) against rosbags' own computation."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest
import rclpy
from common import new_domain, wait_until
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

MESSAGES = Path(__file__).resolve().parents[2] / "ros_ws" / "src" / "skd_msgs" / "msg"
OURS = tuple(f"skd_msgs/msg/{file.stem}" for file in sorted(MESSAGES.glob("*.msg")))
STANDARD = (
    "geometry_msgs/msg/AccelStamped",
    "geometry_msgs/msg/Twist",
    "geometry_msgs/msg/TwistStamped",
    "nav_msgs/msg/Odometry",
    "rosgraph_msgs/msg/Clock",
    "sensor_msgs/msg/LaserScan",
    "visualization_msgs/msg/MarkerArray",
)


@pytest.mark.parametrize("name", [*OURS, *STANDARD])
def test_hashes_on_the_wire_are_those_of_rosbags(name: str) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    for file in MESSAGES.glob("*.msg"):
        store.register(get_types_from_msg(file.read_text(), f"skd_msgs/msg/{file.stem}"))
    package, _, message = name.split("/")
    kind = getattr(importlib.import_module(f"{package}.msg"), message)
    context = rclpy.Context()
    rclpy.init(args=[], context=context, domain_id=new_domain())
    node = rclpy.create_node("publisher", context=context)
    try:
        node.create_publisher(kind, "topic", 1)
        (info,) = wait_until(lambda: node.get_publishers_info_by_topic("/topic"))
        digest = bytes(info.topic_type_hash.value).hex()
        assert f"RIHS{info.topic_type_hash.version:02}_{digest}" == store.hash_rihs01(name)
    finally:
        node.destroy_node()
        rclpy.try_shutdown(context=context)
