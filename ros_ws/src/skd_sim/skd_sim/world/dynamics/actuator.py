"""The brake between the command and the wheels: a dead time, then a pressure that changes at a limited rate.

Dead time and build-up are what every friction brake has. UN Regulation 13-H allows a passenger car 0.6 s from the pedal
to the required deceleration; the equation of its stopping distance, 0.1·v [km/h], stands for a loss of 0.36 s.
"""

from __future__ import annotations

import numpy as np

from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel

_NOW, _NEXT, _QUEUE = 0, 1, 2  # places in the state: brake now (m/s²), next place of the queue to read, the queue


def new_brake(delay: float, step: float) -> FloatArray:
    """Return the state of a released brake.

    Args:
        delay: dead time, s; rounded to whole steps.
        step: duration of a step, s.
    """
    return np.zeros(_QUEUE + round(delay / step))


@kernel
def apply_brake(brake: FloatArray, demand: float, rate: float, step: float) -> float:
    """Advance the brake by one step and return the deceleration (m/s², ≥ 0) that its mean torque in it stands for.

    Args:
        brake: state, changed in place.
        demand: deceleration commanded now, m/s², ≥ 0.
        rate: limit on build-up and on release, m/s³.
        step: duration of a step, s.
    """
    length = brake.size - _QUEUE
    delayed = demand
    if length > 0:
        place = _QUEUE + int(brake[_NEXT])
        delayed = brake[place]
        brake[place] = demand
        brake[_NEXT] = (brake[_NEXT] + 1.0) % length
    change = rate * step
    before = brake[_NOW]
    brake[_NOW] = before + min(change, max(-change, delayed - before))
    return float(0.5 * (before + brake[_NOW]))
