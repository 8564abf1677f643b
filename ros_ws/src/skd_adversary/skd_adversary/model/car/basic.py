"""The adversary's predictive model of the car (paper, "Generating Kamikaze Trajectories").

The car follows the basic policy with an unknown or known multiplier; what is unknown is a prior, carried as a state
variable by the belief.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from skd_sim.errors import UsageError


@dataclass(frozen=True)
class CarModel:
    """Predicted policy of the car: brake within C·κ, with C ~ U[multiplier_low, multiplier_high].

    Attributes:
        multiplier_low: least C thought possible.
        multiplier_high: greatest C thought possible; equal to the least where C is known.
        observes_position: whether the adversary senses the relative position (basic car) or the distance only.
    """

    multiplier_low: float
    multiplier_high: float
    observes_position: bool

    def __post_init__(self) -> None:
        if not (0.0 <= self.multiplier_low <= self.multiplier_high < math.inf):
            raise UsageError(f"car model needs 0 ≤ low ≤ high, got {self.multiplier_low:g}, {self.multiplier_high:g}")


def known_basic_car(multiplier: float) -> CarModel:
    """Return the model of a basic car whose C the adversary knows (paper, "Kamikaze Trajectories")."""
    return CarModel(multiplier, multiplier, observes_position=True)


def unknown_car() -> CarModel:
    """Return the model of a car of which nothing is known: C anywhere over and around the paper's range."""
    return CarModel(0.25, 1.5, observes_position=False)
