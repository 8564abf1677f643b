"""Emergency brakes by a distance, of Berkeley, Honda and Mazda, and the Intelligent Driver Model.

Each brake has one formula for the distance below which it brakes fully, and one table of constants. Formulas and
constants are those that Seiler, Song and Hedrick compare ("Development of a collision avoidance system", SAE 980853,
1998). They are written for a car ahead in the lane. SKD's own variant for pedestrians, cyclists and cars that cut in
takes them as ahead where `RelativeState.enters` says so.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import NamedTuple

import numpy as np

from skd_sim.controllers.reference_drivers import ReferenceDriver, RelativeState
from skd_sim.scenario.scenario import Scenario


class DistanceBrake(ReferenceDriver):
    """Brakes at once and fully when who is ahead is nearer than a distance."""

    braking: float
    """Full braking, m/s²."""
    delay, jerk = 0.0, math.inf

    def is_critical(self, one: RelativeState) -> bool:
        """Tell whether who is ahead is that near, and slower."""
        return one.enters and one.approach > 0.0 and one.gap <= self.distance(one.speed, max(0.0, one.lead))

    def demand(self, one: RelativeState) -> float:
        """Return full braking, m/s²."""
        return self.braking

    @abstractmethod
    def distance(self, speed: float, lead: float) -> float:
        """Return the distance (m) at which to brake, from the speeds of the car and of who leads, m/s."""


class MazdaBrake(DistanceBrake):
    """Doi et al., "Development of a rear-end collision avoidance system with automatic brake control", JSAE 1994."""

    braking = 6.0  # m/s², α1
    LEAD = 8.0  # m/s², α2
    SYSTEM, DRIVER = 0.1, 0.6  # s, τ1 and τ2
    STANDING = 5.0  # m, R_min

    def distance(self, speed: float, lead: float) -> float:
        """Return what both need to stop, and the delays."""
        stops = 0.5 * (speed**2 / self.braking - lead**2 / self.LEAD)
        return stops + speed * self.SYSTEM + (speed - lead) * self.DRIVER + self.STANDING


class HondaBrake(DistanceBrake):
    """Fujita, Akuzawa and Sato, "Radar brake system", ITS America 1995; it does not avoid all collisions."""

    braking = 7.8  # m/s², α1 and α2
    SYSTEM, BRAKING_TIME = 0.5, 1.5  # s, τ1 and τ2

    def distance(self, speed: float, lead: float) -> float:
        """Return the distance from the two times; shorter where who leads stands before the second."""
        first, second, braking = self.SYSTEM, self.BRAKING_TIME, self.braking
        if lead / braking >= second:
            return second * (speed - lead) + first * second * braking - 0.5 * braking * first**2
        return second * speed - 0.5 * braking * (second - first) ** 2 - lead**2 / (2.0 * braking)


class BerkeleyBrake(DistanceBrake):
    """Seiler, Song and Hedrick 1998: brakes when a collision can only be made weaker."""

    braking = 6.0  # m/s², α
    DELAY = 1.2  # s, τ1 + τ2: driver and brake

    def distance(self, speed: float, lead: float) -> float:
        """Return the distance that is lost in the delay, who leads braking."""
        return (speed - lead) * self.DELAY + 0.5 * self.braking * self.DELAY**2


EXPONENT = 4  # δ
_LEAST_GAP = 0.01  # m, where the law would divide by nothing


class IdmConstants(NamedTuple):
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


PUBLISHED = IdmConstants()


def idm_acceleration(
    speed: float, desired_speed: float, gap: float, approach: float, driver: IdmConstants = PUBLISHED
) -> float:
    """Return v̇ (m/s²) of the model, without a bound: v̇ = a·[1 − (v/v₀)⁴ − (s*/s)²], s* = s₀ + v·T + v·Δv/(2√(ab)).

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


class IdmDriver(ReferenceDriver):
    """The Intelligent Driver Model (Treiber, Hennecke and Helbing 2000): follows who is ahead and in its lane.

    v₀, 120 km/h in table I, is the scenario's speed. The model has no bound: the car's brake is one. SKD's own variant
    for pedestrians and cyclists takes them for cars as soon as they are in the lane, wherever they go.
    """

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Take the lane, too."""
        super().reset(scenario, rng)
        self._beside = 0.5 * scenario.road.lane_width - self._half_width

    def _answer(self, speed: float, found: list[RelativeState]) -> float:
        """Return the least acceleration (m/s²) that any road user calls for."""
        gaps = [(one.gap, one.approach) for one in found if self.is_critical(one)] or [(math.inf, 0.0)]
        return min(idm_acceleration(speed, self._desired, gap, approach) for gap, approach in gaps)

    def is_critical(self, one: RelativeState) -> bool:
        """Tell whether it is ahead in the lane."""
        return one.gap >= 0.0 and one.aside <= self._beside
