"""Cars that ask when the adversary and when they themselves will be where their ways cross (post-encroachment time).

Both keep their velocities; whoever comes first has to have left by a margin of time before the other comes. The
stretch where the ways cross is the strip that the car sweeps, at the place where the adversary is when it is in it.
"""

from __future__ import annotations

import math

import numpy as np
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import AdversaryState, CarState

from cars.view import Eyes, View, towards

SLOWEST = 0.1  # m/s: who moves less stands


def in_strip(view: View, reach: float) -> tuple[float, float]:
    """Return from when until when (s) the adversary is on the strip of half width `reach` (m); from > until: never."""
    if abs(view.leftwards) < SLOWEST:
        return (0.0, math.inf) if abs(view.left) <= reach else (math.inf, -math.inf)
    times = sorted((-view.left + side * reach) / view.leftwards for side in (-1.0, 1.0))
    return (max(0.0, times[0]), times[1]) if times[1] >= 0.0 else (math.inf, -math.inf)


def time_between(view: View, eyes: Eyes, speed: float) -> float:
    """Return how long (s) passes between the one's leaving the crossing and the other's coming.

    Negative: they are there together; infinity: at least one of them never comes.

    Args:
        view: of the adversary.
        eyes: with both shapes.
        speed: of the car, m/s.
    """
    enters, leaves = in_strip(view, eyes.reach)
    if enters > leaves or speed < SLOWEST:
        return math.inf
    gap = view.gap + (speed - view.closing) * (enters if math.isfinite(enters) else 0.0)  # where it comes in
    behind = gap + 2.0 * eyes.radius + eyes.length
    if behind < 0.0:
        return math.inf
    arrives, is_past = max(0.0, gap) / speed, behind / speed
    return max(arrives - leaves, enters - is_past)


class EncroachmentBrake:
    """Brakes hard where the time between the two is less than half a second, as long as it is not past."""

    control_period = 0.05
    LEAST = 0.5  # s
    DECELERATION = 6.5  # m/s²
    AHEAD = 3.0  # s, beyond which it does not look

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Take shapes and speed from the scenario; the law keeps nothing and draws nothing."""
        self._eyes, self._desired = Eyes(scenario), scenario.car.start_speed

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Return the acceleration (m/s²)."""
        view = self._eyes.see(car, adversary)
        near = view.gap < self.AHEAD * car.speed
        if near and time_between(view, self._eyes, car.speed) < self.LEAST:
            return -self.DECELERATION
        return towards(car.speed, self._desired) if car.speed > SLOWEST or not near else self._restart(view)

    def _restart(self, view: View) -> float:
        """Stand while somebody is ahead on the strip."""
        blocked = abs(view.left) <= self._eyes.reach + 0.3 and view.gap > -self._eyes.length
        return 0.0 if blocked else towards(0.0, self._desired)


class PoliteEncroachmentBrake(EncroachmentBrake):
    """Leaves a second and a half, and brakes gently."""

    LEAST = 1.5
    DECELERATION = 3.5
    AHEAD = 4.0
