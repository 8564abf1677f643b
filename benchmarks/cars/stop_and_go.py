"""Cars with a state: they come to a stop before whoever is on the lane, wait, and go on slowly until they have passed.

Driving, stopping, waiting, creeping: what they do depends on what they did. Ten decisions a second.
"""

from __future__ import annotations

from enum import Enum

import numpy as np
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import AdversaryState, CarState

from cars.view import Eyes, View, towards


class Phase(Enum):
    """What such a car does."""

    DRIVING = "driving"
    STOPPING = "stopping"
    WAITING = "waiting"
    CREEPING = "creeping"


class StopAndGo:
    """Stops within its braking distance and some more for anybody on the lane, stands for a second, then creeps by."""

    control_period = 0.1
    DECELERATION = 4.0  # m/s²
    FURTHER = 1.5  # m, beyond the braking distance, at which it begins to stop
    BESIDE = 0.5  # m beside the lane, where somebody counts as on it
    PATIENCE = 1.0  # s, for which it stands after the lane was last seen blocked
    CREEP = 2.0  # m/s, until the adversary is passed

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Forget the last episode; the law draws nothing."""
        self._eyes, self._desired = Eyes(scenario), scenario.car.start_speed
        self._edge = 0.5 * scenario.road.lane_width + self.BESIDE
        self._phase, self._waited = Phase.DRIVING, 0

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Return the acceleration (m/s²)."""
        view = self._eyes.see(car, adversary)
        self._phase = self._next(car.speed, view)
        if self._phase == Phase.STOPPING:
            return -self.DECELERATION
        if self._phase == Phase.WAITING:
            return 0.0
        return towards(car.speed, self._desired if self._phase == Phase.DRIVING else self.CREEP)

    def _next(self, speed: float, view: View) -> Phase:
        blocked = view.gap > -self._eyes.radius and abs(view.left) <= self._edge
        near = blocked and view.gap <= speed * speed / (2.0 * self.DECELERATION) + self.FURTHER
        if self._phase == Phase.DRIVING:
            return Phase.STOPPING if near else Phase.DRIVING
        if self._phase == Phase.STOPPING:
            self._waited = 0
            return Phase.WAITING if speed == 0.0 else Phase.STOPPING
        if self._phase == Phase.WAITING:
            self._waited = 0 if near else self._waited + 1
            return Phase.CREEPING if self._waited >= round(self.PATIENCE / self.control_period) else Phase.WAITING
        if near:
            return Phase.STOPPING
        return Phase.DRIVING if view.gap < -self._eyes.length else Phase.CREEPING


class HastyStopAndGo(StopAndGo):
    """Looks at its half of the lane alone, brakes late and hard, hardly waits, and creeps fast."""

    DECELERATION = 7.0
    FURTHER = 0.5
    BESIDE = -0.5
    PATIENCE = 0.2
    CREEP = 4.0
