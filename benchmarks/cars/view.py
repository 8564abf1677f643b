"""What the cars of this folder see, in their own frame, and how they drive where nothing is in their way."""

from __future__ import annotations

import math
from typing import NamedTuple

from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import to_car_frame
from skd_sim.world.state import AdversaryState, CarState

GAIN = 1.0  # 1/s: a difference of speed of 1 m/s asks for 1 m/s²
COMFORTABLE = 1.5  # m/s², with which they speed up


class View(NamedTuple):
    """Somebody, seen from a car.

    Attributes:
        gap: from the front bumper to the near side of the adversary, along the car, m; negative beside or behind it.
        left: of the car's axis, m.
        closing: by how much the gap shrinks, m/s.
        leftwards: velocity to the left, m/s.
    """

    gap: float
    left: float
    closing: float
    leftwards: float

    def left_after(self, duration: float) -> float:
        """Return where the adversary is across the car's axis in so many seconds, velocities kept, m."""
        return self.left + duration * self.leftwards

    @property
    def time_to_collision(self) -> float:
        """Seconds until the front is level with the adversary, velocities kept; infinity: never, or it has passed."""
        return self.gap / self.closing if self.closing > 0.0 and self.gap >= 0.0 else math.inf


class Eyes:
    """Sees a scenario's adversary from a scenario's car.

    Attributes:
        reach: offset (m) of an adversary's centre at which it touches the strip that the car sweeps.
        radius: of the adversary, m.
        length: of the car, m.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Take both shapes from the scenario.

        Raises:
            UsageError: its road has curves; what is to the left of a car's axis says nothing there.
        """
        if not scenario.road.straight:
            raise UsageError(f"this controller knows straight roads only; that of scenario {scenario.name} has curves")
        self._front = scenario.car.front
        self.reach, self.radius = scenario.path_edge, scenario.adversary.reach
        self.length = scenario.car.front + scenario.car.rear

    def see(self, car: CarState, adversary: AdversaryState) -> View:
        """Return where the adversary is and how it moves, without noise or delay."""
        ahead, left = to_car_frame(adversary.x, adversary.y, car.x, car.y, car.heading)
        along, leftwards = to_car_frame(adversary.vx, adversary.vy, 0.0, 0.0, car.heading)
        return View(ahead - self._front - self.radius, left, car.speed - along, leftwards)


def towards(speed: float, wanted: float, brake: float = COMFORTABLE) -> float:
    """Return the acceleration (m/s²) that leads from a speed to a wanted one (m/s), braking with `brake` at most."""
    return min(COMFORTABLE, max(-brake, GAIN * (wanted - speed)))
