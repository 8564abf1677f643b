"""A car and a road user over time, from whatever source: what all surrogate safety measures are computed of.

Between two moments both move uniformly, as in the contact test (`skd_sim.world.contact`); seen from the car the
other's centre then runs along a straight segment.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from skd_sim.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Scene:
    """Two road users over time, in any frame in which the ground does not move.

    Attributes:
        times: n moments, s, strictly increasing.
        car: n × 4: reference point (x, y), m, heading, rad, and speed, m/s.
        other: n × 2, centre of the other road user, m.
        velocity: n × 2, velocity of the other in the same frame, m/s.
        turned: n, where the other's box points, rad; not used for a disc.
        footprint: of the car: ahead of its reference point, behind it and to each side, m.
        shape: of the other: radius, half length and half width, m; a disc has a radius, a box has none.
    """

    times: FloatArray
    car: FloatArray
    other: FloatArray
    velocity: FloatArray
    turned: FloatArray
    footprint: tuple[float, float, float]
    shape: tuple[float, float, float]

    def __len__(self) -> int:
        return len(self.times)

    @cached_property
    def seen(self) -> FloatArray:
        """Centre of the other in the car's frame: ahead and to the left of its reference point, n × 2, m."""
        return self._in_car_frame(self.other - self.car[:, :2])

    @cached_property
    def moving(self) -> FloatArray:
        """Velocity of the other along the axes of the car's frame, n × 2, m/s: its own, not as seen from the car."""
        return self._in_car_frame(self.velocity)

    @cached_property
    def turned_from_car(self) -> FloatArray:
        """Where the other's box points from the car's heading, n, rad."""
        return self.turned - self.car[:, 2]

    @cached_property
    def extent(self) -> FloatArray:
        """Half of what the other takes along and across the car's heading, n × 2, m."""
        radius, half_length, half_width = self.shape
        if radius > 0.0:
            return np.full((len(self), 2), radius)
        cos, sin = np.abs(np.cos(self.turned_from_car)), np.abs(np.sin(self.turned_from_car))
        return np.column_stack([cos * half_length + sin * half_width, sin * half_length + cos * half_width])

    @cached_property
    def gap(self) -> FloatArray:
        """From the car's front to the nearest edge of the other along the car's heading, n, m; below 0 beside it."""
        return np.asarray(self.seen[:, 0] - self.extent[:, 0] - self.footprint[0])

    @cached_property
    def closing(self) -> FloatArray:
        """How fast the gap closes, n, m/s."""
        return np.asarray(self.car[:, 3] - self.moving[:, 0])

    def _in_car_frame(self, vectors: FloatArray) -> FloatArray:
        cos, sin = np.cos(self.car[:, 2]), np.sin(self.car[:, 2])
        x, y = vectors.T
        return np.column_stack([cos * x + sin * y, cos * y - sin * x])
