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

NEARLY: Final = 0.05
"""m, m/s: what answers that differ by `side_by_side.TOLERANCE` do not come to within half a minute."""


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


def led_otherwise(way: LedWay) -> bool:
    """Lead the car on a way anew, in the process that this one keeps for its controller; tell if it goes otherwise.

    A car that was asked by `commands` may go by a little otherwise, as `command` may answer so.
    """
    controller = apart(way.episode.car)
    most = NEARLY if controller.takes_batches else ALIKE
    branch = Branch(way.episode, lambda: controller)
    user = branch.world.adversary
    for (vx, vy), car in zip(way.velocities.tolist(), way.cars, strict=True):
        user, contact = branch.go_on(user, (vx, vy))
        if contact is not None or float(np.max(np.abs(np.subtract(branch.world.car, car)))) > most:
            return True
    return False
