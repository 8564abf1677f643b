"""Recorded ways in the world frame, where nothing but the car's own way says how that lies."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from skd_sim.arrays import FloatArray


class Seen(NamedTuple):
    """A way as it is seen from the car's.

    Attributes:
        positions: n × 2 (East, North), m.
        mirrored: whether East and West were exchanged, so that it goes East.
        aside: how far the car was off its straight line at most, m.
    """

    positions: FloatArray
    mirrored: bool
    aside: float


def seen_from_car(car: FloatArray, way: FloatArray) -> Seen:
    """Return a recorded way in the world frame.

    Rotated so that the car drives North: its direction and x = 0 are those of the straight line fitted to its positions
    (total least squares). Mirrored, if need be, so that the way goes East. y = 0 is where it crosses x = 0 for the
    first time (linear interpolation), or its first point where it does not.

    Args:
        car: k × 2 positions of the car, m, which are not all the same.
        way: n × 2 positions of the road user, m, in the same frame.
    """
    centre = car.mean(axis=0)
    direction = np.linalg.svd(car - centre, full_matrices=False)[2][0]
    if direction @ (car[-1] - car[0]) < 0.0:
        direction = -direction
    across = np.array([direction[1], -direction[0]])
    offset = way - centre
    north = offset @ direction
    east = offset @ across
    mirrored = bool(east[-1] < east[0])
    if mirrored:
        east = -east
    after = np.flatnonzero((east[:-1] < 0.0) & (east[1:] >= 0.0))
    origin = north[0]
    if len(after):
        i = int(after[0])
        origin = north[i] + (north[i + 1] - north[i]) * east[i] / (east[i] - east[i + 1])
    aside = float(np.abs((car - centre) @ across).max())
    return Seen(np.column_stack([east, north - origin]), mirrored, aside)
