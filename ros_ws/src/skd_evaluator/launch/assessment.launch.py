"""The Safe-Kamikaze Distance of one car: `ros2 launch skd_evaluator assessment.launch.py --show-args`."""

from launch import LaunchDescription
from skd_evaluator.ros.launch_support import Argument, graph_description


def generate_launch_description() -> LaunchDescription:
    """Return the launch of an assessment."""
    return graph_description(
        "assessment",
        (
            Argument("safe_count", 5, "safe trajectories"),
            Argument("kamikaze_count", 100, "kamikaze trajectories per safe trajectory"),
            Argument("collision_runs", 500, "runs of the car against a pedestrian on the safe trajectories"),
            Argument("maximum_distance", 0.0, "discard pairs further apart than this, m; 0: keep all"),
        ),
    )
