"""Ways on which a search has led a car, and whether the car goes so again when nobody makes copies of it."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from skd_sim.apart.apart import apart
from skd_sim.arrays import FloatArray
from skd_sim.episode.episode import Episode
from skd_sim.simulation.branching import Branch

ALIKE: Final = 1e-6
"""m, m/s, m/s²: what libraries that add up in several threads may differ by."""


class LedWay(NamedTuple):
    """Some ticks of an episode as a search has simulated them, from the start.

    Attributes:
        episode: episode whose random draws the ticks have.
        velocities: velocity of the adversary in each tick, n × 2, m/s.
        cars: state of the car after each tick, n × 4, as `CarState` has it.
    """

    episode: Episode
    velocities: FloatArray
    cars: FloatArray


def led_otherwise(way: LedWay) -> float:
    """Lead the car on a way anew, in the process that this one keeps for its controller.

    Returns:
        The greatest difference between both cars: in m, rad and m/s; infinity where it does not come as far.
    """
    branch = Branch(way.episode, lambda: apart(way.episode.car))
    user, far = branch.world.adversary, 0.0
    for (vx, vy), car in zip(way.velocities.tolist(), way.cars, strict=True):
        user, contact = branch.go_on(user, (vx, vy))
        far = max(far, float(np.max(np.abs(np.subtract(branch.world.car, car)))))
        if contact is not None:
            return float("inf")
    return far
