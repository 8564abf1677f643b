"""Post-encroachment time: how long after the one has left the place where their ways cross does the other come.

B. L. Allen, B. T. Shin and P. J. Cooper, "Analysis of traffic conflicts and collisions", Transportation Research Record
667, 1978. The way of the car is the strip that its outline sweeps, that of the other what its outline takes while it
reaches into this strip; both as they went, and nothing is predicted. It is defined on a straight way of the car.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from skd_sim.arrays import FloatArray, IntArray
from skd_sim.kernels.compilation import kernel

from skd_evaluator.metrics.surrogate.scene import Scene
from skd_evaluator.metrics.surrogate.scenes import Scenes

_STRAIGHT = 1e-6
"""rad by which the car's heading may change: rounding."""


def post_encroachment_time(scene: Scene) -> float:
    """Return the post-encroachment time, s: 0 where both were there at a time, nan where one of them never was.

    Raises:
        ValueError: the car turned, so that there is no strip with two straight edges.
    """
    found, turned = _of_scenes(Scenes.of(scene))
    if turned[0]:
        raise ValueError("the post-encroachment time is defined here on a straight way of the car")
    return float(found[0])


def post_encroachment_times(scenes: Scenes) -> FloatArray:
    """Return the post-encroachment time in each scene, k, s; nan where the car turned, too."""
    found, turned = _of_scenes(scenes)
    return np.where(turned, math.nan, found)


def _of_scenes(scenes: Scenes) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Return the post-encroachment time in each scene, k, s, and whether the car turned in it."""
    scene = scenes.whole
    begins = scenes.starts[np.searchsorted(scenes.starts, np.arange(len(scene)), side="right") - 1]
    headings = scene.car[begins, 2]
    turned = scenes.most(np.abs(scene.car[:, 2] - headings)) > _STRAIGHT
    # Everything along and across the car's first place.
    cos, sin = np.cos(headings), np.sin(headings)
    origin = scene.car[begins, :2]
    (x, y), (car_x, car_y) = (scene.other - origin).T, (scene.car[:, :2] - origin).T
    front, rear, half_width = scene.footprint
    places = np.column_stack([cos * car_x + sin * car_y, cos * x + sin * y, cos * y - sin * x])
    return _between(scenes.starts, scene.times, places, scene.extent, front, rear, half_width), turned


@kernel
def _between(
    starts: IntArray,
    times: FloatArray,
    places: FloatArray,
    extent: FloatArray,
    front: float,
    rear: float,
    half_width: float,
) -> FloatArray:
    """Return the post-encroachment time in each scene, k, s; nan where one of them was never there.

    Args:
        starts: where each scene begins.
        times: moments, s.
        places: n × 3: how far the car has come, and how far along and across its way the other is, m.
        extent: n × 2: half of what the other takes along and across, m.
        front: of the car's footprint, m.
        rear: of the car's footprint, m.
        half_width: of the car's footprint, m.
    """
    found = np.full(len(starts) - 1, np.nan)
    for scene in range(len(starts) - 1):
        first, end = starts[scene], starts[scene + 1]
        at, along, across = times[first:end], places[first:end, 1], places[first:end, 2]
        driven = places[first:end, 0]
        reaches = half_width + extent[first:end, 1]
        inside = _both(_spans(at, reaches - across), _spans(at, reaches + across))
        if not len(inside):
            continue
        enters, leaves = inside[0, 0], inside[-1, 1]
        low, high, reach = np.inf, -np.inf, 0.0
        for row in range(len(at)):
            reach = max(reach, extent[first + row, 0])
            if enters <= at[row] <= leaves:
                low, high = min(low, along[row]), max(high, along[row])
        for moment in (enters, leaves):
            place = np.interp(moment, at, along)
            low, high = min(low, place), max(high, place)
        covered = _both(_spans(at, driven + front - (low - reach)), _spans(at, high + reach - (driven - rear)))
        for a, b in covered:
            for c, d in inside:
                apart = 0.0 if a < d and c < b else max(c - b, a - d)
                if not found[scene] <= apart:
                    found[scene] = apart
    return found


@kernel
def _spans(times: FloatArray, depth: FloatArray) -> FloatArray:
    """Return the spans of time, m × 2, in which a quantity that is straight between moments is above 0."""
    found = np.empty((len(times), 2))
    count, begin = 0, times[0] if depth[0] > 0.0 else np.nan
    for index in range(1, len(times)):
        before, after = depth[index - 1], depth[index]
        if (before > 0.0) != (after > 0.0):
            crossing = times[index - 1] + (times[index] - times[index - 1]) * before / (before - after)
            if after > 0.0:
                begin = crossing
            else:
                found[count] = begin, crossing
                count += 1
    if depth[-1] > 0.0:
        found[count] = begin, times[-1]
        count += 1
    return found[:count]


@kernel
def _both(some: FloatArray, others: FloatArray) -> FloatArray:
    """Return the spans of time, m × 2, that are in one of some and in one of others."""
    found = np.empty((len(some) * len(others), 2))
    count = 0
    for a, b in some:
        for c, d in others:
            if max(a, c) < min(b, d):
                found[count] = max(a, c), min(b, d)
                count += 1
    return found[:count]
