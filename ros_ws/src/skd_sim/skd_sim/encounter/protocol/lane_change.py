"""How a target changes lanes: on an arc, straight on, and on an arc back, at one speed.

As Euro NCAP's CCFhol has it, whose arcs have radii of 125 m (50 km/h, 44 m) and 250 m (70 km/h, 60 m) with 10 m between
them (Vector's OSC-NCAP-scenarios, catalogue of trajectories, GVT_CCFhol_50 and GVT_CCFhol_70). Here a fifth of the way
is straight, whatever the speed.
"""

from __future__ import annotations

import math

import numpy as np

from skd_sim.arrays import FloatArray

_STRAIGHT = 0.2
_HALVINGS = 60


def changed_over(way: FloatArray, length: float, aside: float) -> tuple[FloatArray, FloatArray]:
    """Return how far one who changes lanes has got along the lane and across it, both of them m.

    Before the change and after it the way leads straight along the lane.

    Args:
        way: that has been covered since the change began, m; negative before it.
        length: of the change, m of the way.
        aside: by how much it leads across, m, at least 0 and at most half of the length.
    """
    angle = _angle(length, aside)
    arc, straight = 0.5 * (1.0 - _STRAIGHT) * length, _STRAIGHT * length
    radius = arc / angle
    within = np.clip(way, 0.0, length)
    first = np.minimum(within, arc) / radius
    between = np.clip(within - arc, 0.0, straight)
    second = angle - np.maximum(within - arc - straight, 0.0) / radius
    along = radius * (np.sin(first) + math.sin(angle) - np.sin(second)) + between * math.cos(angle)
    across = radius * (1.0 - np.cos(first) + np.cos(second) - math.cos(angle)) + between * math.sin(angle)
    return along + (way - within), across


def _angle(length: float, aside: float) -> float:
    """Return by how much the way is turned between the two arcs, rad."""

    def across(angle: float) -> float:
        arc = (1.0 - _STRAIGHT) * length * (1.0 - math.cos(angle)) / angle
        return arc + _STRAIGHT * length * math.sin(angle)

    low, high = 1e-9, 0.5 * math.pi
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if across(middle) < aside else (low, middle)
    return 0.5 * (low + high)
