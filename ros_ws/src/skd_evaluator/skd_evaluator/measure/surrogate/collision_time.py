"""Time to collision: how soon two road users would touch if nothing changed (Hayward 1972).

J. C. Hayward, "Near-miss determination through use of a scale of danger", Highway Research Record 384, 1972: both keep
their velocities. The contact is that of their outlines, and exact.
"""

from __future__ import annotations

import math

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.geometry.contact import first_contact, first_contact_of_boxes

from skd_evaluator.measure.surrogate.scene import Scene

HORIZON = 20.0
"""s beyond which nobody is foreseen to touch: at 100 km/h more than half a kilometre."""


def collision_times(scene: Scene) -> FloatArray:
    """Return the time to collision at each moment, n, s; infinite where the two would pass each other."""
    seen = scene.seen
    drift = scene.moving - np.column_stack([scene.car[:, 3], np.zeros(len(scene))])
    after = seen + HORIZON * drift
    radius, half_length, half_width = scene.shape
    front, rear, side = scene.footprint
    shares = np.empty(len(scene))
    for index, ((a, b), (c, d)) in enumerate(zip(seen.tolist(), after.tolist(), strict=True)):
        if radius > 0.0:
            shares[index] = first_contact(a, b, c, d, front, rear, side, radius)
        else:
            turned = float(scene.turned_from_car[index])
            shares[index] = first_contact_of_boxes(a, b, c, d, turned, front, rear, side, half_length, half_width)
    return np.asarray(HORIZON * shares)


def least_collision_time(scene: Scene) -> float:
    """Return the least time to collision over all moments, s; infinite where there was never one."""
    return float(collision_times(scene).min(initial=math.inf))
