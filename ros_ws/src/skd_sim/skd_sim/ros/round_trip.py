"""`python -m skd_sim.ros.round_trip`: which packages of ROS 2 there are, and whether a message comes through.

Prints JSON. Two participants of the middleware, as of two processes: what one publishes the other has to hear.
"""

from __future__ import annotations

import importlib.util
import json
import sys
import time

from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.utilities import get_rmw_implementation_identifier
from std_msgs.msg import Header

PACKAGES = (
    "rclpy", "std_msgs", "geometry_msgs", "nav_msgs", "sensor_msgs", "visualization_msgs", "trajectory_msgs",
    "diagnostic_msgs", "tf2_msgs", "ackermann_msgs", "vision_msgs", "lifecycle_msgs", "skd_msgs", "std_srvs",
    "sensor_msgs_py", "tf2_ros", "tf2_geometry_msgs", "message_filters", "cv_bridge", "autoware_control_msgs",
)  # fmt: skip
"""What drivers of cars import, most of them from the beginning of this list."""
PATIENCE = 15.0  # s


def round_trip() -> float | None:
    """Return after how many seconds a message that is published again and again is heard; None: it is not."""
    contexts = [Context(), Context()]
    heard: list[Header] = []
    begin = time.monotonic()
    try:
        for context in contexts:
            context.init()
        speaker, listener = (Node(f"skd_doctor_{number}", context=one) for number, one in enumerate(contexts))
        publisher = speaker.create_publisher(Header, "/skd_doctor", 10)
        listener.create_subscription(Header, "/skd_doctor", heard.append, 10)
        executor = SingleThreadedExecutor(context=contexts[1])
        executor.add_node(listener)
        while not heard and time.monotonic() - begin < PATIENCE:
            publisher.publish(Header(frame_id="doctor"))
            executor.spin_once(timeout_sec=0.05)
        executor.shutdown()
        for node in (speaker, listener):
            node.destroy_node()
    finally:
        for context in contexts:
            context.try_shutdown()
    return time.monotonic() - begin if heard else None


if __name__ == "__main__":
    found = {name: importlib.util.find_spec(name) is not None for name in PACKAGES}
    said = {"packages": found, "middleware": get_rmw_implementation_identifier(), "round_trip": round_trip()}
    print(json.dumps(said))
    sys.exit(0 if said["round_trip"] is not None else 1)
