"""The car under test: the protocol that a user's controller fulfils, and the paper's basic controller."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np

from skd_sim.compilation import kernel
from skd_sim.errors import UsageError
from skd_sim.geometry import to_car_frame
from skd_sim.scenario import Scenario
from skd_sim.state import CarState, PedestrianState

PAPER_MULTIPLIERS = (0.5, 0.625, 0.75, 0.875, 1.0, 1.05, 1.1, 1.125, 1.15)
"""The nine multipliers C of the paper, section "The Cars"."""


@runtime_checkable
class Controller(Protocol):
    """What SKD asks of a controller under test; a class with these two methods is enough."""

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Forget the last episode; draw randomness, if any, from `rng` only."""

    def command(self, car: CarState, pedestrian: PedestrianState) -> float:
        """Return the acceleration (m/s²) for the coming time step."""


@kernel
def basic_acceleration(distance: float, trigger: float, deceleration: float) -> float:
    """Return the basic controller's acceleration (m/s²): brake while 0 ≤ distance ≤ C·κ (paper, "The Cars").

    Args:
        distance: from the front bumper to the pedestrian's centre along the lane, m.
        trigger: C·κ, m.
        deceleration: full braking, m/s² (> 0).
    """
    return -deceleration if 0.0 <= distance <= trigger else 0.0


class BasicController:
    """Brakes fully while the pedestrian is within C·κ ahead, wherever across the road (paper, "The Cars")."""

    def __init__(self, multiplier: float = 1.0) -> None:
        """Make the controller.

        Args:
            multiplier: C, ≥ 0; a higher one brakes earlier and is safer.

        Raises:
            UsageError: the multiplier is negative or not finite.
        """
        if not (math.isfinite(multiplier) and multiplier >= 0.0):
            raise UsageError(f"multiplier must be a finite number ≥ 0, got {multiplier:g}")
        self.multiplier = float(multiplier)

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Take footprint, deceleration and κ from the scenario."""
        self._front = scenario.car.front
        self._deceleration = scenario.car.deceleration
        self._trigger = self.multiplier * scenario.car.safe_distance

    def command(self, car: CarState, pedestrian: PedestrianState) -> float:
        """Return −deceleration within the trigger distance, else 0 (m/s²)."""
        ahead, _ = to_car_frame(pedestrian.x, pedestrian.y, car.x, car.y, car.heading)
        return float(basic_acceleration(ahead - self._front, self._trigger, self._deceleration))


def make_controller(name: str, multiplier: float = 1.0) -> Controller:
    """Make a controller by name.

    Args:
        name: `basic`, or `package.module:Class` of a user's controller (made without arguments).
        multiplier: C of the basic controller.

    Raises:
        UsageError: unknown name, a module or class that cannot be loaded, or a class that is no `Controller`.
    """
    if name == "basic":
        return BasicController(multiplier)
    module_name, separator, class_name = name.partition(":")
    if not (separator and module_name and class_name):
        raise UsageError(f"unknown controller {name!r}; give basic, or package.module:Class for your own")
    try:
        factory: Callable[[], object] = getattr(importlib.import_module(module_name), class_name)
        controller = factory()
    except Exception as error:  # a user's module may raise anything
        reason = f"{type(error).__name__}: {error}"
        raise UsageError(f"controller {name!r} cannot be loaded: {reason}; is it on PYTHONPATH?") from error
    if not isinstance(controller, Controller):
        raise UsageError(f"controller {name!r} needs the methods reset(scenario, rng) and command(car, pedestrian)")
    return controller
