"""Emergency brakes by time to collision, 20 decisions a second, and such brakes with hysteresis and a delay.

With both velocities kept, is the adversary on the strip that the car sweeps when the front gets there, and how soon is
that? Such a brake lets go as soon as it has slowed down enough for the time to be longer again: towards somebody who
stands in its way it creeps.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import AdversaryState, CarState

from cars.view import Eyes, View, towards

MARGIN = 0.2  # m, by which the strip that counts is wider than the car


def time_to_collision(view: View, eyes: Eyes) -> float:
    """Return in how many seconds the front meets the adversary, velocities kept; infinity: it will not be there."""
    if -eyes.length - eyes.radius < view.gap < 0.0 and abs(view.left) < eyes.reach:
        return 0.0  # nearer than its radius: they all but touch
    after = view.time_to_collision
    if math.isinf(after) or abs(view.left_after(after)) > eyes.reach + MARGIN:
        return math.inf
    return after


class CollisionTimeBrake:
    """Brakes while the time to collision is below a threshold, and drives on otherwise."""

    control_period = 0.05
    THRESHOLD = 1.5  # s
    DECELERATION = 6.0  # m/s²

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Take shapes and speed from the scenario; the law keeps nothing and draws nothing."""
        self._eyes, self._desired = Eyes(scenario), scenario.car.start_speed

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Return the acceleration (m/s²)."""
        if time_to_collision(self._eyes.see(car, adversary), self._eyes) < self.THRESHOLD:
            return -self.DECELERATION
        return towards(car.speed, self._desired)


class EarlyBrake(CollisionTimeBrake):
    """Brakes early and gently."""

    THRESHOLD = 2.2
    DECELERATION = 4.0


class LateBrake(CollisionTimeBrake):
    """Brakes late and hard."""

    THRESHOLD = 0.9
    DECELERATION = 8.0


class LatchedBrake:
    """The same brake, 0.2 s late, which lets go only when the time to collision has been long for a while."""

    control_period = 0.05
    THRESHOLD = 1.5  # s, below which it brakes
    RELEASE = 3.0  # s, above which it may let go …
    HELD = 0.5  # s … after so long
    DELAY = 4  # decisions, 0.2 s, until a command reaches the wheels
    DECELERATION = 6.0  # m/s²

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Forget the last episode; the law draws nothing."""
        self._eyes, self._desired = Eyes(scenario), scenario.car.start_speed
        self._under_way: deque[float] = deque([0.0] * self.DELAY)
        self._braking, self._clear = False, 0

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Return the acceleration (m/s²) that was decided `DELAY` decisions ago."""
        time = time_to_collision(self._eyes.see(car, adversary), self._eyes)
        self._clear = self._clear + 1 if time > self.RELEASE else 0
        if time < self.THRESHOLD:
            self._braking = True
        elif self._clear * self.control_period >= self.HELD:
            self._braking = False
        self._under_way.append(-self.DECELERATION if self._braking else towards(car.speed, self._desired))
        return self._under_way.popleft()


class GentleLatchedBrake(LatchedBrake):
    """Latched, with an earlier and gentler brake."""

    THRESHOLD = 2.0
    DECELERATION = 4.5
