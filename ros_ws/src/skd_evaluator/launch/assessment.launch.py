"""The Safe-Kamikaze Distance of one car: `ros2 launch skd_evaluator assessment.launch.py --show-args`."""

from launch import LaunchDescription
from skd_evaluator.ros.launch_support import graph_description


def generate_launch_description() -> LaunchDescription:
    """Return the launch of an assessment."""
    return graph_description("assessment")
