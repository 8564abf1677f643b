"""Where a kamikaze believed the car to be, beside where it was."""

from __future__ import annotations

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.scenario.road import right_and_along
from skd_sim.scenario.scenario import Scenario

DEVIATIONS = 2.0
"""Standard deviations to each side of the mean that pictures show: about 95 %."""


def believed_car(scenario: Scenario, car: FloatArray, belief: FloatArray) -> FloatArray | None:
    """Return what was believed at each tick, n × 4; None where nothing is known.

    First how far ahead of its true place on the road the car was believed to be, and the standard deviation of that, m;
    then its speed and the standard deviation of that, m/s. Where nobody decided any more it is what was last believed,
    the car moving on.

    Args:
        scenario: scenario of the test.
        car: n × 2 or more, place (x, y) of the car's reference point at ticks, m.
        belief: what was believed of the car at ticks, n × 4, as in `skd_sim.world.episode.EpisodeLog`.
    """
    known = np.isfinite(belief).all(axis=1)
    if not known.any():
        return None
    along = right_and_along(scenario.road.line, np.ascontiguousarray(car[:, :2]))[:, 1]
    found = np.column_stack([belief[:, 0] - along, belief[:, 1:]])
    ticks = np.arange(len(found))
    last = np.maximum.accumulate(np.where(known, ticks, np.flatnonzero(known)[0]))
    return found[last]
