"""Cars that plan: a few accelerations are tried over some seconds, the cheapest begins, jerk is limited.

The adversary is predicted with the velocity that it has, and takes up more room the further ahead it is. The memory is
the last acceleration, from which the next one differs by what the jerk allows, as does each step of a plan.
"""

from __future__ import annotations

import numpy as np
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import AdversaryState, CarState

from cars.view import Eyes, View

CANDIDATES = (-7.0, -5.0, -3.5, -2.0, -1.0, 0.0, 0.75, 1.5)  # m/s², which a plan approaches and then keeps


@kernel
def plan_cost(
    gap: float, left: float, along: float, leftwards: float, speed: float, desired: float, acceleration: float,
    target: float, shape: tuple[float, float, float], step: float, steps: int, jerk: float, spread: float, fear: float,
) -> float:  # fmt: skip
    """Return what it costs to go from an acceleration to a target (m/s²) as fast as the jerk allows, and stay there.

    Args:
        gap: front bumper to the adversary, m.
        left: of the adversary, m.
        along: its velocity along the car, m/s.
        leftwards: its velocity to the left, m/s.
        speed: of the car, m/s.
        desired: speed, m/s.
        acceleration: now, m/s².
        target: of the plan, m/s².
        shape: reach, adversary's radius, car's length, m.
        step: of the plan, s.
        steps: their number.
        jerk: largest, m/s³.
        spread: by which the adversary grows, m/s.
        fear: cost of an overlap for each m/s of the car's speed.
    """
    reach, radius, length = shape
    cost, worst, driven = 0.0, 0.0, 0.0
    for index in range(steps):
        change = jerk * step
        acceleration = min(acceleration + change, max(acceleration - change, target))
        after = max(0.0, speed + step * acceleration)
        driven += 0.5 * step * (speed + after)
        speed = after
        time = step * (index + 1)
        room = spread * time
        before = gap + along * time - driven
        beside = abs(left + leftwards * time)
        if before < room and before + length + 2.0 * radius > -room and beside < reach + room:
            worst = max(worst, fear * speed * (1.0 - 0.5 * index / steps))
        cost += step * ((speed - desired) ** 2 + 0.3 * acceleration * acceleration)
    return cost + worst


class SamplingPlanner:
    """Plans 3 s ahead ten times a second, and may change its acceleration quickly."""

    control_period = 0.1
    JERK = 15.0  # m/s³
    SPREAD = 0.4  # m/s
    FEAR = 100.0
    STEP, STEPS = 0.15, 20

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Forget the last episode; the law draws nothing."""
        self._eyes, self._desired = Eyes(scenario), scenario.car.start_speed
        self._acceleration = 0.0

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Return the acceleration (m/s²)."""
        view = self._eyes.see(car, adversary)
        best = min(CANDIDATES, key=lambda target: self._cost(view, car.speed, target))
        change = self.JERK * self.control_period
        low, high = self._acceleration - change, self._acceleration + change
        self._acceleration = min(high, max(low, best))
        if car.speed == 0.0:
            self._acceleration = max(0.0, self._acceleration)  # a car that stands holds no deceleration
        return self._acceleration

    def _cost(self, view: View, speed: float, target: float) -> float:
        place = view.gap, view.left, speed - view.closing, view.leftwards
        shape = self._eyes.reach, self._eyes.radius, self._eyes.length
        settings = self.STEP, self.STEPS, self.JERK, self.SPREAD, self.FEAR
        return float(plan_cost(*place, speed, self._desired, self._acceleration, target, shape, *settings))


class SmoothPlanner(SamplingPlanner):
    """Plans as far, for a comfortable ride: little jerk, little fear of who may still change his way."""

    JERK = 5.0
    SPREAD = 0.1
    FEAR = 60.0
