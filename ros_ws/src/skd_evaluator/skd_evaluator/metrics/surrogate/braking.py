"""How hard the car has to brake: required deceleration, brake threat number and time headway.

* Required deceleration (J. Jansson, Collision Avoidance Theory, Linköping 2005, section 5.3.5, of a road user that does
  not accelerate): the constant deceleration after which the gap ahead no longer closes when it is used up, w²/(2·gap),
  with w the speed at which it closes. It is 0 where the two would pass each other if both kept their velocities.
* Brake threat number (M. Brännström, J. Sjöberg and E. Coelingh, "A situation and threat assessment algorithm for a
  rear-end collision avoidance system", IEEE Intelligent Vehicles Symposium 2008): the required deceleration as a share
  of the one that the car has; above 1 braking alone no longer helps.
* Time headway (SAE J2944, section 8.1): how long the front takes to be where the rear of who is ahead is now.
"""

from __future__ import annotations

import math

import numpy as np
from skd_sim.arrays import FloatArray

from skd_evaluator.metrics.surrogate.collision_time import collision_times
from skd_evaluator.metrics.surrogate.scene import Scene

MOST = 9.81
"""m/s² at which a greatest required deceleration ends: tyres have no more, and at a contact it is infinite."""
_TOUCHING = 1e-6  # m: whom the front touches is not beside it by rounding


def required_decelerations(scene: Scene) -> FloatArray:
    """Return the required deceleration at each moment, n, m/s²; infinite at a contact of the front.

    It is 0 where the other is beside the car or behind its front: braking no longer decides whether they touch.
    """
    on_course = np.isfinite(collision_times(scene)) & (scene.closing > 0.0) & (scene.gap >= -_TOUCHING)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):  # of speeds and gaps next to 0
        needed = scene.closing**2 / (2.0 * np.maximum(scene.gap, 0.0))
    return np.where(on_course, needed, 0.0)


def greatest_required_deceleration(scene: Scene) -> float:
    """Return the greatest required deceleration over all moments, m/s², at most `MOST`."""
    return min(MOST, float(required_decelerations(scene).max(initial=0.0)))


def brake_threat_numbers(scene: Scene, deceleration: float) -> FloatArray:
    """Return the brake threat number at each moment, n.

    Args:
        scene: the two.
        deceleration: what the car has, m/s², > 0.

    Raises:
        ValueError: no such deceleration.
    """
    if not (math.isfinite(deceleration) and deceleration > 0.0):
        raise ValueError(f"the deceleration that the car has must be above 0, got {deceleration}")
    return np.asarray(required_decelerations(scene) / deceleration)


def headways(scene: Scene) -> FloatArray:
    """Return the time headway at each moment, n, s; infinite where nobody is ahead in the car's strip, or it stands."""
    aside = np.abs(scene.seen[:, 1]) - scene.extent[:, 1]
    ahead = (scene.gap >= -_TOUCHING) & (aside < scene.footprint[2]) & (scene.car[:, 3] > 0.0)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):  # of speeds and gaps next to 0
        return np.where(ahead, np.maximum(scene.gap, 0.0) / scene.car[:, 3], np.inf)
