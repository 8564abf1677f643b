"""Three brakes of known order: early, middle and late, alike in all but the time to collision at which they begin.

Each looks at the strip that the car sweeps and at whoever, of whatever shape, is on it, or will be when the front gets
there. Once it brakes it brakes with all its force until the strip is free: so of one and the same approach the earlier
one is never the faster one at the contact.
"""

from __future__ import annotations

import math

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import to_car_frame
from skd_sim.world.state import AdversaryState, CarState

from cars.view import towards

MARGIN = 0.2  # m to either side of the car, within which somebody counts as on its strip


class MiddleTrigger:
    """Brakes with all that the scenario's car has from a time to collision of 1.2 s on."""

    control_period = 0.05
    THRESHOLD = 1.2  # s

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Take shapes, speed and brake from the scenario; the law draws nothing.

        Raises:
            UsageError: its road has curves.
        """
        if not scenario.road.straight:
            raise UsageError(f"this controller knows straight roads only; that of scenario {scenario.name} has curves")
        self._front, self._length = scenario.car.front, scenario.car.front + scenario.car.rear
        self._beside = 0.5 * scenario.car.width + MARGIN
        self._shape, self._braking = scenario.adversary.shape, False
        self._desired, self._deceleration = scenario.car.start_speed, scenario.car.deceleration

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Return the acceleration (m/s²)."""
        after, free = self._time_to_collision(car, adversary)
        self._braking = after < self.THRESHOLD or (self._braking and not free)
        return -self._deceleration if self._braking else towards(car.speed, self._desired)

    def _time_to_collision(self, car: CarState, adversary: AdversaryState) -> tuple[float, bool]:
        """Return the time to collision (s; infinity: none), velocities kept, and whether the strip ahead is free."""
        ahead, left = to_car_frame(adversary.x, adversary.y, car.x, car.y, car.heading)
        along, leftwards = to_car_frame(adversary.vx, adversary.vy, 0.0, 0.0, car.heading)
        radius, half_length, half_width = self._shape
        cos, sin = (abs(of(adversary.heading - car.heading)) for of in (math.cos, math.sin))
        deep = radius or half_length * cos + half_width * sin
        wide = self._beside + (radius or half_length * sin + half_width * cos)
        gap, closing = ahead - self._front - deep, car.speed - along
        here = abs(left) < wide and gap > -self._length - 2.0 * deep
        if gap <= 0.0:
            return (0.0 if here else math.inf), not here
        if closing <= 0.0:
            return math.inf, not here
        after = gap / closing
        there = abs(left + after * leftwards) < wide
        return (after if there else math.inf), not (here or there)


class EarlyTrigger(MiddleTrigger):
    """The same from 2 s on."""

    THRESHOLD = 2.0


class LateTrigger(MiddleTrigger):
    """The same from 0.6 s on."""

    THRESHOLD = 0.6


TRIGGERS = {
    "early": "cars.triggers:EarlyTrigger",
    "middle": "cars.triggers:MiddleTrigger",
    "late": "cars.triggers:LateTrigger",
}
"""As in `--controller`, in their order."""
