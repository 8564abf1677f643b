"""The types that are on the wire are those of the bags: rclpy's hashes (REP 2011) against rosbags' own computation."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
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
    "tf2_msgs/msg/TFMessage",
    "visualization_msgs/msg/MarkerArray",
)
# What rosbags computes of the definitions of vision_msgs 4.1.1 and ackermann_msgs 2.0.2, from their own repositories.


@pytest.fixture(scope="module")
def on_the_wire() -> Iterator[Callable[[str], str]]:
    """What a publisher of a type says its hash is."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context, domain_id=new_domain())
    node = rclpy.create_node("publisher", context=context)

    def hash_of(name: str) -> str:
        package, _, message = name.split("/")
        topic = f"/{package}_{message}"
        node.create_publisher(getattr(importlib.import_module(f"{package}.msg"), message), topic, 1)
        (info,) = wait_until(lambda: node.get_publishers_info_by_topic(topic))
        return f"RIHS{info.topic_type_hash.version:02}_{bytes(info.topic_type_hash.value).hex()}"

    yield hash_of
    node.destroy_node()
    rclpy.try_shutdown(context=context)


@pytest.mark.parametrize("name", [*OURS, *STANDARD])
def test_hashes_on_the_wire_are_those_of_rosbags(on_the_wire: Callable[[str], str], name: str) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    for file in MESSAGES.glob("*.msg"):
        store.register(get_types_from_msg(file.read_text(), f"skd_msgs/msg/{file.stem}"))
    assert on_the_wire(name) == store.hash_rihs01(name)
