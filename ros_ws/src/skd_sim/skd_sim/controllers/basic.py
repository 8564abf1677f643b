"""The paper's basic controller."""

from __future__ import annotations

import math

import numpy as np

from skd_sim.errors import UsageError
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.road import road_position
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import to_car_frame
from skd_sim.world.state import AdversaryState, CarState

PAPER_MULTIPLIERS = (0.5, 0.625, 0.75, 0.875, 1.0, 1.05, 1.1, 1.125, 1.15)
"""The nine multipliers C of the paper, section "The Cars"."""


@kernel
def basic_acceleration(distance: float, trigger: float, deceleration: float) -> float:
    """Return the basic controller's acceleration (m/s²): brake while 0 ≤ distance ≤ C·κ (paper, "The Cars").

    Args:
        distance: distance from the front bumper to the adversary's centre along the lane, m.
        trigger: distance up to which the car brakes, C·κ, m.
        deceleration: full braking, m/s² (> 0).
    """
    return -deceleration if 0.0 <= distance <= trigger else 0.0


class BasicController:
    """Brakes fully while the adversary is within C·κ ahead along the road, wherever across it (paper, "The Cars")."""

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
        self._line = None if scenario.road.straight else scenario.road.line

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Return −deceleration within the trigger distance, else 0 (m/s²)."""
        if self._line is None:
            ahead, _ = to_car_frame(adversary.x, adversary.y, car.x, car.y, car.heading)
        else:
            here, _ = road_position(self._line, car.x, car.y)
            ahead = road_position(self._line, adversary.x, adversary.y)[0] - here
        return float(basic_acceleration(ahead - self._front, self._trigger, self._deceleration))
