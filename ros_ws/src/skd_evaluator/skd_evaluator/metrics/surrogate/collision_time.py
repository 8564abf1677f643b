"""Time to collision: how soon two road users would touch if nothing changed (Hayward 1972).

J. C. Hayward, "Near-miss determination through use of a scale of danger", Highway Research Record 384, 1972: both keep
their velocities. The contact is that of their outlines, and exact.
"""

from __future__ import annotations

import math

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.road import right_and_along, road_pose
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import first_contact, first_contact_of_boxes, to_car_frame

from skd_evaluator.metrics.surrogate.scene import Scene

HORIZON = 20.0
"""s beyond which nobody is foreseen to touch: at 100 km/h more than half a kilometre."""


def collision_times(scene: Scene) -> FloatArray:
    """Return the time to collision at each moment, n, s; infinite where the two would pass each other."""
    drift = scene.moving - np.column_stack([scene.car[:, 3], np.zeros(len(scene))])
    after = scene.seen + HORIZON * drift
    return np.asarray(HORIZON * _shares(scene.seen, after, scene.turned_from_car, scene.footprint, scene.shape))


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
        seen = np.array([to_car_frame(x, y, *pose) for (x, y), pose in zip(places, way, strict=True)])
        turned = np.full(len(seen) - 1, scene.turned_from_car[index])
        shares = _shares(seen[:-1], seen[1:], turned, scene.footprint, scene.shape)
        (parts,) = np.nonzero(shares <= 1.0)
        if parts.size:
            found[index] = (parts[0] + shares[parts[0]]) * step
    return found


@kernel
def _shares(
    before: FloatArray,
    after: FloatArray,
    turned: FloatArray,
    footprint: tuple[float, float, float],
    shape: tuple[float, float, float],
) -> FloatArray:
    """Return the share of each straight segment in the car's frame at which the outlines first touch, else infinity.

    Args:
        before: n × 2, where the other's centre is in the beginning, m.
        after: n × 2, and in the end, m.
        turned: n, where its box points from the car's heading, rad.
        footprint: of the car, as in `Scene`.
        shape: of the other, as in `Scene`.
    """
    found = np.empty(before.shape[0])
    front, rear, side = footprint
    radius, half_length, half_width = shape
    for row in range(before.shape[0]):
        a, b, c, d = before[row, 0], before[row, 1], after[row, 0], after[row, 1]
        if radius > 0.0:
            found[row] = first_contact(a, b, c, d, front, rear, side, radius)
        else:
            found[row] = first_contact_of_boxes(a, b, c, d, turned[row], front, rear, side, half_length, half_width)
    return found
