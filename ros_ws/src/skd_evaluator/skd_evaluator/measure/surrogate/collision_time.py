"""Time to collision: how soon two road users would touch if nothing changed (Hayward 1972).

J. C. Hayward, "Near-miss determination through use of a scale of danger", Highway Research Record 384, 1972: both keep
their velocities. The contact is that of their outlines, and exact.
"""

from __future__ import annotations

import math

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.encounter.road import right_and_along, road_pose
from skd_sim.encounter.scenario import Scenario
from skd_sim.geometry.contact import first_contact, first_contact_of_boxes, to_car_frame

from skd_evaluator.measure.surrogate.scene import Scene

HORIZON = 20.0
"""s beyond which nobody is foreseen to touch: at 100 km/h more than half a kilometre."""


def collision_times(scene: Scene) -> FloatArray:
    """Return the time to collision at each moment, n, s; infinite where the two would pass each other."""
    seen = scene.seen
    drift = scene.moving - np.column_stack([scene.car[:, 3], np.zeros(len(scene))])
    after = seen + HORIZON * drift
    pairs = zip(seen.tolist(), after.tolist(), strict=True)
    shares = np.array([_share(scene, index, (a, b), (c, d)) for index, ((a, b), (c, d)) in enumerate(pairs)])
    return np.asarray(HORIZON * shares)


def least_collision_time(scene: Scene) -> float:
    """Return the least time to collision over all moments, s; infinite where there was never one."""
    return float(collision_times(scene).min(initial=math.inf))


def path_collision_times(scene: Scene, scenario: Scenario, phi: FloatArray) -> FloatArray:
    """Return the time to collision along predicted paths at each moment, n, s; infinite where they do not lead to one.

    The car goes on along its lane at the speed that it has; the other does what φ does from this moment on, from where
    it is, and stands after the end of φ. A box keeps its heading.

    Args:
        scene: of an episode in this scenario, from its start.
        scenario: the lane, and the duration of a tick.
        phi: φ at ticks, m.
    """
    line, step = scenario.road.line, scenario.time_step
    along = right_and_along(line, np.ascontiguousarray(scene.car[:, :2]))[:, 1]
    ticks = step * np.arange(len(phi))
    later = step * np.arange(math.ceil(HORIZON / step) + 1)
    found = np.full(len(scene), math.inf)
    for index, now in enumerate(scene.times.tolist()):
        walked = np.column_stack([np.interp(now + later, ticks, column) for column in phi.T])
        places = (scene.other[index] + walked - walked[0]).tolist()
        way = [road_pose(line, float(along[index] + scene.car[index, 3] * ahead)) for ahead in later.tolist()]
        seen = [to_car_frame(x, y, *pose) for (x, y), pose in zip(places, way, strict=True)]
        for part in range(len(seen) - 1):
            share = _share(scene, index, seen[part], seen[part + 1])
            if share <= 1.0:
                found[index] = (part + share) * step
                break
    return found


def _share(scene: Scene, index: int, before: tuple[float, float], after: tuple[float, float]) -> float:
    """Return the share of a straight segment in the car's frame at which the outlines first touch, else infinity."""
    (a, b), (c, d), (front, rear, side) = before, after, scene.footprint
    radius, half_length, half_width = scene.shape
    if radius > 0.0:
        return float(first_contact(a, b, c, d, front, rear, side, radius))
    turned = float(scene.turned_from_car[index])
    return float(first_contact_of_boxes(a, b, c, d, turned, front, rear, side, half_length, half_width))
