"""Cars that slow down near anybody, in proportion to the distance, wherever he goes; they never stop."""

from __future__ import annotations

import math

import numpy as np
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import AdversaryState, CarState

from cars.view import Eyes, towards


class SlowsNearAnybody:
    """Drives at so many m/s for each metre to whoever is ahead or beside it."""

    PER_METRE = 0.6  # 1/s
    LEAST = 2.0  # m/s
    BRAKE = 4.0  # m/s²

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Take shapes and speed from the scenario; the law keeps nothing and draws nothing."""
        self._eyes, self._desired = Eyes(scenario), scenario.car.start_speed

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Return the acceleration (m/s²)."""
        view = self._eyes.see(car, adversary)
        if view.gap < -self._eyes.length:  # behind
            return towards(car.speed, self._desired)
        distance = math.hypot(max(0.0, view.gap), max(0.0, abs(view.left) - self._eyes.reach))
        wanted = min(self._desired, max(self.LEAST, self.PER_METRE * distance))
        return towards(car.speed, wanted, self.BRAKE)


class SlowsLate(SlowsNearAnybody):
    """Slows down later, and less."""

    PER_METRE = 1.0
    LEAST = 3.0
    BRAKE = 3.0
