"""The Intelligent Driver Model (Treiber, Hennecke and Helbing 2000); an adversary on the lane is a standing car to it.

v̇ = a·[1 − (v/v₀)⁴ − (s*/s)²] with the desired gap s* = s₀ + v·T + v·Δv/(2√(ab)): their equations 3 and 4, with the
constants of their table I. Only v₀, 120 km/h there, is the speed of the scenario here; and the brake is the scenario's,
as of the other cars, for what is compared is how cars decide.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from skd_sim.controllers.carla_agent import sub_steps
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import to_car_frame
from skd_sim.world.state import AdversaryState, CarState, next_speed, travelled

EXPONENT = 4  # δ


class Driver(NamedTuple):
    """What distinguishes one driver from another in the model; by default table I of its paper.

    Attributes:
        headway: T, s.
        acceleration: a, m/s².
        braking: b, comfortable, m/s².
        standing_gap: s₀, m.
    """

    headway: float = 1.6
    acceleration: float = 0.73
    braking: float = 1.67
    standing_gap: float = 2.0


PUBLISHED = Driver()
_LEAST_GAP = 0.01  # m, where the law would divide by nothing


def idm_acceleration(
    speed: float, desired_speed: float, gap: float, approach: float, driver: Driver = PUBLISHED
) -> float:
    """Return v̇ (m/s²) of the model, without a bound.

    Args:
        speed: v, m/s.
        desired_speed: v₀, m/s.
        gap: s, from the front bumper to what is ahead, m; infinity: nothing is.
        approach: Δv, by how much faster the car is than that, m/s.
        driver: constants of the model.
    """
    dynamic = speed * approach / (2.0 * math.sqrt(driver.acceleration * driver.braking))
    desired = driver.standing_gap + speed * driver.headway + dynamic
    interaction = max(0.0, desired) / max(gap, _LEAST_GAP)
    return driver.acceleration * (1.0 - (speed / desired_speed) ** EXPONENT - interaction * interaction)


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

    DRIVER = Driver(headway=1.0, acceleration=1.5, braking=3.0)
    BESIDE = 1.0

    def _brake(self, scenario: Scenario) -> float:
        return 7.0
