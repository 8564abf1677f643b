"""The braking law of examples/vendor_controller, called without its node: the same function on the same messages.

It needs ROS 2's Python messages, which come with the first graph command.
"""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import AdversaryState, CarState

SOURCE = Path(__file__).resolve().parents[2] / "examples" / "vendor_controller" / "vendor_controller.py"


def vendor_module() -> ModuleType:
    """Return the example's module.

    Raises:
        ImportError: ROS 2 is not there.
    """
    specification = importlib.util.spec_from_file_location("vendor_controller", SOURCE)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


class VendorCar:
    """Stands in for the node towards its own law: it has the node's parameters, with their defaults."""

    def __init__(self) -> None:
        """Load the law."""
        module = vendor_module()
        self._law: Any = module.VendorController.acceleration
        self._message: Any = module.Odometry
        self._settings = {name: default for name, default, *_ in module.PARAMETERS}

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Take the footprint from the scenario; the law keeps nothing and draws nothing."""
        self._settings.update(front=scenario.car.front, rear=scenario.car.rear)

    def get_parameter(self, name: str) -> SimpleNamespace:
        """Return a parameter as rclpy does: an object with its value."""
        return SimpleNamespace(value=self._settings[name])

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Return what the law commands (m/s²) upon the two odometries of a tick."""
        here, there = self._message(), self._message()
        here.pose.pose.position.x, here.pose.pose.position.y = car.x, car.y
        here.pose.pose.orientation.z = math.sin(0.5 * car.heading)
        here.pose.pose.orientation.w = math.cos(0.5 * car.heading)
        here.twist.twist.linear.x = car.speed
        there.pose.pose.position.x, there.pose.pose.position.y = adversary.x, adversary.y
        there.pose.pose.orientation.w = 1.0
        there.twist.twist.linear.x, there.twist.twist.linear.y = adversary.vx, adversary.vy
        return float(self._law(self, here, there))
