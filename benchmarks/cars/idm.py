"""The Intelligent Driver Model, to which an adversary on the lane is a standing car, with the scenario's brake.

The formula and its published constants are those of the shipped controller `idm`. Only v₀ is the scenario's speed here;
and the brake is the scenario's, as of the other cars, for what is compared is how cars decide.
"""

from __future__ import annotations

import math

import numpy as np
from skd_sim.controllers.cal import sub_steps
from skd_sim.controllers.reference_drivers import PUBLISHED, IdmConstants, idm_acceleration
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import to_car_frame
from skd_sim.world.state import AdversaryState, CarState, next_speed, travelled


class IntelligentDriver:
    """Follows whoever is on its lane ahead, as it would a car that does not move."""

    DRIVER = PUBLISHED
    BESIDE = 0.0  # m beside the lane, where somebody counts as on it

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Take speed, footprint, lane and brake from the scenario; the law draws nothing."""
        self._desired = scenario.car.start_speed
        self._deceleration = self._brake(scenario)
        self._front = scenario.car.front
        self._half_lane = 0.5 * scenario.road.lane_width + self.BESIDE
        self._count, self._duration = sub_steps(scenario.control_duration)

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Return the mean acceleration (m/s²) over the tick, the adversary taken to stand in it."""
        ahead, left = to_car_frame(adversary.x, adversary.y, car.x, car.y, car.heading)
        gap = ahead - self._front
        speed, total = car.speed, 0.0
        for _ in range(self._count):
            in_the_way = abs(left) <= self._half_lane and gap >= 0.0
            wanted = idm_acceleration(speed, self._desired, gap if in_the_way else math.inf, speed, self.DRIVER)
            acceleration = max(-self._deceleration, wanted)
            after = float(next_speed(speed, acceleration, 0.0, self._duration))
            gap -= float(travelled(speed, after, self._duration))
            speed = after
            total += acceleration
        return total / self._count

    def _brake(self, scenario: Scenario) -> float:
        """Return the strongest deceleration, m/s²."""
        return scenario.car.deceleration


class WatchfulDriver(IntelligentDriver):
    """Lively, with a strong brake; to it who is within a metre of the lane is on it."""

    DRIVER = IdmConstants(headway=1.0, acceleration=1.5, braking=3.0)
    BESIDE = 1.0

    def _brake(self, scenario: Scenario) -> float:
        return 7.0
