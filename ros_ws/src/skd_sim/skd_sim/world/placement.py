"""Where the crossing lies in another simulator's map: a pose, and the way there and back.

Both frames are right-handed with z up (REP 103); angles are counter-clockwise, rad.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from skd_sim.world.state import AdversaryState, CarState


class Placement(NamedTuple):
    """Pose of the crossing's frame in the map: the crossing's x axis points along `yaw`."""

    x: float
    y: float
    yaw: float

    def vector_to_map(self, x: float, y: float) -> tuple[float, float]:
        """Return a direction or a velocity of the crossing's frame in the map's axes."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return cos * x - sin * y, sin * x + cos * y

    def vector_to_crossing(self, x: float, y: float) -> tuple[float, float]:
        """Return a direction or a velocity of the map in the crossing's axes."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return cos * x + sin * y, cos * y - sin * x

    def point_to_map(self, x: float, y: float) -> tuple[float, float]:
        """Return a point (m) of the crossing's frame in the map."""
        dx, dy = self.vector_to_map(x, y)
        return self.x + dx, self.y + dy

    def point_to_crossing(self, x: float, y: float) -> tuple[float, float]:
        """Return a point (m) of the map in the crossing's frame."""
        return self.vector_to_crossing(x - self.x, y - self.y)

    def car_to_map(self, car: CarState) -> CarState:
        """Return a car's state in the map."""
        return CarState(*self.point_to_map(car.x, car.y), _wrapped(car.heading + self.yaw), car.speed)

    def car_to_crossing(self, car: CarState) -> CarState:
        """Return a car's state in the crossing's frame."""
        return CarState(*self.point_to_crossing(car.x, car.y), _wrapped(car.heading - self.yaw), car.speed)

    def adversary_to_crossing(self, adversary: AdversaryState) -> AdversaryState:
        """Return an adversary's state in the crossing's frame."""
        return AdversaryState(
            *self.point_to_crossing(adversary.x, adversary.y), *self.vector_to_crossing(adversary.vx, adversary.vy)
        )


def _wrapped(angle: float) -> float:
    """Return the same angle in [−π, π]."""
    return math.remainder(angle, math.tau)
