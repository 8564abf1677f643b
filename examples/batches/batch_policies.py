"""Two policies that answer many episodes at once: one of plain numpy, one a small network.

Both forms of each are the same lines: what `command` is given as numbers, `commands` is given as arrays of n numbers.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray
from skd_sim import AdversaryState, CarState

Array = NDArray[np.float64]


class Anticipating:
    """Brakes for whoever would be in front of the car when it comes there, and else drives on at 30 km/h."""

    def reset(self, scenario: Any, rng: Any) -> None:
        """Take from the scenario how long and wide the car is; nothing is kept from one command to the next."""
        self._front, self._beside = scenario.car.front, scenario.car.half_width + 1.0

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Return the acceleration, m/s²."""
        return float(self.commands(car, adversary))  # type: ignore[arg-type]

    def commands(self, cars: CarState, adversaries: AdversaryState) -> Array:
        """Return the accelerations of n episodes, m/s²: each field of both arguments has n numbers."""
        ahead = adversaries.y - cars.y - self._front
        seconds = np.maximum(ahead, 0.0) / np.maximum(cars.speed, 0.5)
        aside = np.abs(adversaries.x + seconds * adversaries.vx - cars.x)
        brakes = (ahead > 0.0) & (seconds < 2.0) & (aside < self._beside)
        return np.where(brakes, -6.0, np.clip(25.0 / 3.0 - cars.speed, -2.0, 1.5))


class SmallNetwork:
    """A perceptron with two hidden layers of 64 whose weights nobody has trained: it is here for its speed."""

    def __init__(self) -> None:
        rng = np.random.default_rng(1)
        sizes = (7, 64, 64, 1)
        self._layers = [(rng.normal(size=(a, b)) / np.sqrt(a), np.zeros(b)) for a, b in itertools.pairwise(sizes)]

    def reset(self, scenario: Any, rng: Any) -> None:
        """Do nothing: the network has no memory."""

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Return the acceleration, m/s²: a batch of one."""
        one = [np.array([number]) for number in (*car, *adversary)]
        return float(self.commands(CarState(*one[:4]), AdversaryState(*one[4:]))[0])  # type: ignore[arg-type]

    def commands(self, cars: CarState, adversaries: AdversaryState) -> Array:
        """Return the accelerations of n episodes, m/s², between 0 and −7."""
        ahead, aside = adversaries.y - cars.y, adversaries.x - cars.x
        seconds = ahead / np.maximum(cars.speed, 1.0)
        rows = np.column_stack(
            [cars.speed / 8.0, ahead / 10.0, aside / 3.0, adversaries.vx, adversaries.vy, seconds, np.abs(aside)]
        )
        for number, (weights, bias) in enumerate(self._layers):
            rows = rows @ weights + bias
            if number < len(self._layers) - 1:
                rows = np.maximum(rows, 0.0)
        return np.asarray(-7.0 / (1.0 + np.exp(-rows[:, 0])))
