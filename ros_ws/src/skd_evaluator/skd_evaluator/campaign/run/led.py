"""Ways on which somebody was led, and whether the car goes so again when nobody makes copies of it, or plans."""

from __future__ import annotations

from typing import Final, NamedTuple, Self

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.controllers import make_controller, takes_batches
from skd_sim.controllers.isolated import isolated
from skd_sim.episode.episode import Episode
from skd_sim.simulation.branching import Branch
from skd_sim.state import CarState

ALIKE: Final = 1e-6
"""m, m/s, m/s²: what libraries that add up in several threads may differ by."""

NEARLY: Final = 0.05
"""m, m/s: what answers that differ by `side_by_side.TOLERANCE` do not come to within half a minute."""


class LedAdversary:
    """Somebody who is led, whatever the car does: each velocity for a tick, and the last one from then on."""

    depletions = 0

    def __init__(self, velocities: FloatArray) -> None:
        """Take velocities, n × 2, m/s."""
        self._velocities = iter(velocities.tolist())
        self._last: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def along(cls, positions: FloatArray, time_step: float) -> Self:
        """Lead somebody on a way that is known at the ticks, n × 2, m."""
        return cls(np.diff(positions, axis=0) / time_step)

    def act(self, _car: CarState) -> tuple[float, float]:
        """Return the velocity of the next tick; see `Adversary.act`."""
        for vx, vy in self._velocities:
            self._last = (vx, vy)
            break
        return self._last


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


class LedAgain(NamedTuple):
    """What became of a way on which a search had led a car to no contact.

    Attributes:
        otherwise: whether the car went otherwise.
        touched: whether it did, and touched who was led.
    """

    otherwise: bool
    touched: bool


def led_again(way: LedWay) -> LedAgain:
    """Lead the car on a way anew, in the child that this process keeps for its controller.

    A car that was asked by `commands` may go by a little otherwise, as `command` may answer so.
    """
    return isolated(way.episode.car.user_code, _led_again, way)


def _led_again(way: LedWay) -> LedAgain:
    controller = make_controller(way.episode.controller)
    most = NEARLY if takes_batches(controller) else ALIKE
    branch = Branch(way.episode, lambda: controller)
    user, otherwise = branch.world.adversary, False
    for (vx, vy), car in zip(way.velocities.tolist(), way.cars, strict=True):
        user, contact = branch.go_on(user, (vx, vy))
        if contact is not None:
            return LedAgain(True, True)
        otherwise |= float(np.max(np.abs(np.subtract(branch.world.car, car)))) > most
    return LedAgain(otherwise, False)
