"""Post-encroachment time: how long after the one has left the place where their ways cross does the other come.

B. L. Allen, B. T. Shin and P. J. Cooper, "Analysis of traffic conflicts and collisions", Transportation Research Record
667, 1978. The way of the car is the strip that its outline sweeps, that of the other what its outline takes while it
reaches into this strip; both as they went, and nothing is predicted. It is defined on a straight way of the car.
"""

from __future__ import annotations

import math

import numpy as np
from skd_sim.arrays import FloatArray

from skd_evaluator.measure.surrogate.scene import Scene

_STRAIGHT = 1e-6
"""rad by which the car's heading may change: rounding."""


def post_encroachment_time(scene: Scene) -> float:
    """Return the post-encroachment time, s: 0 where both were there at a time, nan where one of them never was.

    Raises:
        ValueError: the car turned, so that there is no strip with two straight edges.
    """
    headings = scene.car[:, 2]
    if np.abs(headings - headings[0]).max() > _STRAIGHT:
        raise ValueError("the post-encroachment time is defined here on a straight way of the car")
    front, rear, half_width = scene.footprint
    ahead = np.array([math.cos(headings[0]), math.sin(headings[0])])
    left = np.array([-ahead[1], ahead[0]])
    # Everything along and across the car's first place.
    driven = (scene.car[:, :2] - scene.car[0, :2]) @ ahead
    along, across = (scene.other - scene.car[0, :2]) @ ahead, (scene.other - scene.car[0, :2]) @ left
    reaches = half_width + scene.extent[:, 1]
    inside = both(spans(scene.times, reaches - across), spans(scene.times, reaches + across))
    if not inside:
        return math.nan
    enters, leaves = inside[0][0], inside[-1][1]
    there = (scene.times >= enters) & (scene.times <= leaves)
    places = [*along[there].tolist(), *(float(np.interp(time, scene.times, along)) for time in (enters, leaves))]
    reach = float(scene.extent[:, 0].max())
    low, high = min(places) - reach, max(places) + reach
    covered = both(spans(scene.times, driven + front - low), spans(scene.times, high - (driven - rear)))
    if not covered:
        return math.nan
    if any(first < last_of and first_of < last for first, last in covered for first_of, last_of in inside):
        return 0.0
    gaps = [max(other[0] - own[1], own[0] - other[1]) for own in covered for other in inside]
    return float(min(gaps))


def spans(times: FloatArray, depth: FloatArray) -> list[tuple[float, float]]:
    """Return the spans of time in which a quantity that is straight between moments is above 0."""
    found: list[tuple[float, float]] = []
    begin = float(times[0]) if depth[0] > 0.0 else None
    for index in range(1, len(times)):
        before, after = float(depth[index - 1]), float(depth[index])
        if (before > 0.0) != (after > 0.0):
            crossing = float(times[index - 1] + (times[index] - times[index - 1]) * before / (before - after))
            if after > 0.0:
                begin = crossing
            elif begin is not None:
                found.append((begin, crossing))
                begin = None
    if begin is not None:
        found.append((begin, float(times[-1])))
    return found


def both(some: list[tuple[float, float]], others: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the spans of time that are in one of some and in one of others."""
    shared = [(max(a, c), min(b, d)) for a, b in some for c, d in others]
    return [(begin, end) for begin, end in shared if begin < end]
