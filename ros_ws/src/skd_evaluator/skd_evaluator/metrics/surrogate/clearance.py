"""How far apart the outlines of car and other are, at every moment and at the least.

Between two moments the other's centre runs along a straight segment in the car's frame. The distance of two convex
bodies is convex along it, so the least one between two moments is found exactly by bisection of its course.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from skd_sim.arrays import FloatArray
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import CarState, RoadUserState

from skd_evaluator.metrics.surrogate.scene import Scene
from skd_evaluator.metrics.surrogate.scenes import Scenes

_SHRINK = 0.5 * (np.sqrt(5.0) - 1.0)  # golden section
_STEPS = 60  # of it: to 1e-12 of a segment


def clearances(scene: Scene) -> FloatArray:
    """Return the distance between the outlines at each moment, n, m; 0 where they touch."""
    return _apart(scene, scene.seen, scene.turned_from_car)


def clearance_at(scenario: Scenario, car: CarState, other: RoadUserState) -> float:
    """Return the distance between the outlines of car and adversary at one moment, m; 0 where they touch.

    Args:
        scenario: gives the shapes.
        car: state of the car.
        other: state of the adversary.
    """
    footprint = scenario.car.front, scenario.car.rear, scenario.car.half_width
    scene = Scene(
        np.zeros(1),
        np.array([car[:4]]),
        np.array([other[:2]]),
        np.array([other[2:4]]),
        np.array([other.heading]),
        footprint,
        scenario.adversary.shape,
    )
    return float(clearances(scene)[0])


def least_clearances(scenes: Scenes) -> FloatArray:
    """Return the least distance between the outlines in each scene, k, m: between the given moments as well."""
    scene = scenes.whole
    apart = clearances(scene)
    least = scenes.least(apart)
    of = np.repeat(np.arange(len(least)), np.diff(scenes.starts))
    starts = np.flatnonzero(np.arange(len(scene)) < scenes.last)
    way = scene.seen[starts + 1] - scene.seen[starts]
    # A distance changes by no more than the way: most stretches cannot have the least one inside of them. A box keeps
    # its heading along a stretch, and turns at its end.
    end = _apart(scene, scene.seen[starts + 1], scene.turned_from_car[starts])
    nearest = 0.5 * (apart[starts] + end - np.hypot(*way.T))
    may = nearest < least[of[starts]]
    starts, way = starts[may], way[may]
    start, turned = scene.seen[starts], scene.turned_from_car[starts]

    def at(share: FloatArray) -> FloatArray:
        return _apart(scene, start + share[:, None] * way, turned)

    low, high = np.zeros(len(start)), np.ones(len(start))
    for _ in range(_STEPS):
        width = _SHRINK * (high - low)
        left, right = high - width, low + width
        nearer = at(left) < at(right)
        low, high = np.where(nearer, low, left), np.where(nearer, right, high)
    np.minimum.at(least, of[starts], at(0.5 * (low + high)))
    return least


def least_clearance(scene: Scene) -> float:
    """Return the least distance between the outlines, m, over the whole time: between the given moments as well."""
    return float(least_clearances(Scenes.of(scene))[0])


def _apart(scene: Scene, seen: FloatArray, turned: FloatArray) -> FloatArray:
    """Return the distance of the outlines with the other's centre at places of the car's frame (n × 2, m)."""
    front, rear, half_width = scene.footprint
    radius, half_length, other_half_width = scene.shape
    if radius > 0.0:
        return np.asarray(np.maximum(0.0, _outside(seen, front, rear, half_width) - radius))
    cos, sin = np.cos(turned), np.sin(turned)
    found = np.full(len(seen), np.inf)
    for along, across in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        # A corner of the other in the car's frame, and one of the car in the other's.
        a, b = along * half_length, across * other_half_width
        corner = seen + np.column_stack([cos * a - sin * b, sin * a + cos * b])
        found = np.minimum(found, _outside(corner, front, rear, half_width))
        x, y = np.where(along > 0, front, -rear) - seen[:, 0], across * half_width - seen[:, 1]
        own = np.column_stack([cos * x + sin * y, cos * y - sin * x])
        found = np.minimum(found, _outside(own, half_length, half_length, other_half_width))
    return np.where(_overlap(scene, seen, cos, sin), 0.0, found)


def _outside(points: FloatArray, front: float, rear: float, half_width: float) -> FloatArray:
    """Return how far points are from a rectangle about the origin, n, m; 0 inside."""
    ahead, left = points.T
    beyond = np.maximum(0.0, np.maximum(ahead - front, -rear - ahead))
    return np.asarray(np.hypot(beyond, np.maximum(0.0, np.abs(left) - half_width)))


def _overlap(scene: Scene, seen: FloatArray, cos: FloatArray, sin: FloatArray) -> npt.NDArray[np.bool_]:
    """Return whether two rectangles overlap: no edge's direction separates them."""
    front, rear, half_width = scene.footprint
    _, other_length, other_width = scene.shape
    half_length = 0.5 * (front + rear)
    x, y = seen[:, 0] - 0.5 * (front - rear), seen[:, 1]
    c, s = np.abs(cos), np.abs(sin)
    return np.asarray(
        (np.abs(x) <= half_length + c * other_length + s * other_width)
        & (np.abs(y) <= half_width + s * other_length + c * other_width)
        & (np.abs(cos * x + sin * y) <= c * half_length + s * half_width + other_length)
        & (np.abs(cos * y - sin * x) <= s * half_length + c * half_width + other_width)
    )
