"""One episode through the node graph: `ros2 launch skd_evaluator episode.launch.py --show-args`."""

from launch import LaunchDescription
from skd_evaluator.ros.launch_support import graph_description


def generate_launch_description() -> LaunchDescription:
    """Return the launch of one episode."""
    return graph_description("episode")
