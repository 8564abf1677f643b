"""Graded brakes by the deceleration that it takes to stop before somebody: v²/2d.

The adversary counts where it is on the lane, or walks onto it. Ten decisions a second.
"""

from __future__ import annotations

import numpy as np
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import AdversaryState, CarState

from cars.view import Eyes, towards

LEAST_DISTANCE = 0.1  # m, where the law would divide by nothing


class RequiredDecelerationBrake:
    """Brakes with what it takes, and a little more, as soon as that is above a threshold."""

    control_period = 0.1
    THRESHOLD = 2.0  # m/s²
    MORE = 1.2  # times what it takes
    STRONGEST = 7.0  # m/s²
    STANDOFF = 1.0  # m, before whom it wants to stop

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Take shapes, lane and speed from the scenario; the law keeps nothing and draws nothing."""
        self._eyes, self._desired = Eyes(scenario), scenario.car.start_speed
        self._half_lane = 0.5 * scenario.road.lane_width

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Return the acceleration (m/s²)."""
        view = self._eyes.see(car, adversary)
        on_lane = abs(view.left) <= self._half_lane + self._eyes.radius
        comes = view.left * view.leftwards < 0.0
        if view.gap < -self._eyes.radius or not (on_lane or comes):
            return towards(car.speed, self._desired)
        distance = max(LEAST_DISTANCE, view.gap - self.STANDOFF)
        required = car.speed * car.speed / (2.0 * distance)
        if required > self.THRESHOLD:
            return -min(self.STRONGEST, self.MORE * required)
        return towards(car.speed, self._desired)


class LateRequiredBrake(RequiredDecelerationBrake):
    """Waits until it has to brake hard, and stops near."""

    THRESHOLD = 4.5
    STANDOFF = 0.3
