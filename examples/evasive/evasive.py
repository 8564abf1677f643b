"""Cars that evade: they brake, go aside in their lane, or change to the lane to their left, or two of these.

Each acts when the time to collision is below 1.4 s, until the pedestrian is out of its path, and comes back behind it.
"""

from __future__ import annotations

import math

import numpy as np
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import AdversaryState, CarState

TRIGGER, RELEASE = 1.4, 2.2  # s to a collision: begins to act, and ends
BESIDE = 0.5  # m beside the car that count as its path
SIDE_ACCELERATION = 1.6  # m/s² with which it comes to its new offset
SHARPEST_BEND = 0.2  # 1/m
SHARPEST = 0.4  # of its speed, to the side at the most
COMES_BACK = 0.4  # of the haste with which it evades


class Brakes:
    """Brakes with 7 m/s² and keeps to its lane."""

    control_period = 0.05  # s
    steers_by = "curvature"
    brake = 7.0  # m/s²
    aside = 0.0  # m to the side; of which side is seen when it begins
    lane = 0.0  # m to the right: offset of another lane to which it changes

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Begin on the middle of the lane."""
        self._front, self._rear = scenario.car.front, scenario.car.rear
        self._half_width, self._cruise = scenario.car.half_width, scenario.car.start_speed
        self._acts, self._evades, self._target = False, False, 0.0

    def command(self, car: CarState, adversary: AdversaryState) -> tuple[float, float]:
        """Return acceleration (m/s²) and curvature (1/m)."""
        gap = adversary.y - car.y - self._front
        time = gap / max(car.speed, 0.1)
        there = adversary.x + adversary.vx * min(max(time, 0.0), 2.0)
        low, high = sorted((adversary.x - car.x, there - car.x))
        in_path = low < self._half_width + BESIDE and high > -self._half_width - BESIDE
        if gap > -0.5 and in_path and time < TRIGGER:
            if not self._acts and not self._evades and (self.aside or self.lane):
                self._evades = True
                self._target = self.lane or math.copysign(self.aside, car.x - there)
            self._acts = True
        elif time > RELEASE or not in_path or gap < -0.5:
            self._acts = False
        cruising = 1.5 if car.speed < self._cruise and not self._evades else 0.0
        if not self._evades:
            return (-self.brake if self._acts else cruising), 0.0
        passed = gap < -(self._front + self._rear) - 0.5
        curvature = self._towards(car, 0.0, COMES_BACK) if passed else self._towards(car, self._target)
        return (-self.brake if self._acts else cruising), curvature

    def _towards(self, car: CarState, target: float, haste: float = 1.0) -> float:
        """Return the curvature that leads to an offset to the right (m), and along the lane there."""
        speed, off = max(car.speed, 1.0), target - car.x
        most = haste * min(math.sqrt(2.0 * SIDE_ACCELERATION * abs(off)), 2.0 * abs(off), SHARPEST * speed)
        heading = -math.asin(max(-0.5, min(0.5, math.copysign(most, off) / speed)))
        return max(-SHARPEST_BEND, min(SHARPEST_BEND, (heading - (car.heading - math.pi / 2.0)) / (0.22 * speed)))


class BrakesAside(Brakes):
    """Brakes, and goes aside in its lane, behind the pedestrian."""

    aside = 0.55


class Aside(BrakesAside):
    """Goes aside in its lane and does not brake."""

    brake = 0.0


class OtherLane(Brakes):
    """Changes to the lane to the left and does not brake."""

    brake, lane = 0.0, -3.5


class BrakesToOtherLane(Brakes):
    """Changes to the lane to the left, and brakes with 3.5 m/s²."""

    brake, lane = 3.5, -3.5
