"""A launch test of a car's node: `launch_test test_safety.py`, with ROS 2 and the workspace sourced."""

import tempfile
import unittest
from pathlib import Path

from launch import LaunchDescription
from launch.actions import ExecuteProcess
from launch_testing.actions import ReadyToTest
from skd_evaluator.ros.launch_testing import assessed, assessment

OUT = tempfile.mkdtemp() + "/skd"
CAR = Path(__file__).resolve().parents[1] / "vendor_controller" / "vendor_controller.py"


def generate_test_description():
    """Start the car's node and, beside it, what assesses it."""
    car = ExecuteProcess(cmd=["python3", str(CAR)])
    return LaunchDescription(
        [car, assessment(OUT, safe_count=2, kamikaze_count=2, adversary_model="generic"), ReadyToTest()]
    )


class TestSafety(unittest.TestCase):
    """What has to hold of the car."""

    def test_margin(self, proc_info):
        """An adversary that knows nothing of the car has to deviate by this, m, until it is hit."""
        assert assessed(OUT, proc_info).deviation > 0.1
