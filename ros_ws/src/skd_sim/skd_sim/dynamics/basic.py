"""The paper's basic car: the speed follows the command at once, up to noise (section "The Cars")."""

from __future__ import annotations

import math

import numpy as np

from skd_sim.compilation import kernel
from skd_sim.dynamics.interface import Noise
from skd_sim.motion import draw_relative, next_speed, travelled
from skd_sim.scenario import Car
from skd_sim.state import CarState
from skd_sim.trajectory import FloatArray


@kernel
def _draw(speed_noise: float, acceleration_noise: float, rng: np.random.Generator) -> tuple[float, float]:
    speed_draw = draw_relative(speed_noise, rng)
    return speed_draw, draw_relative(acceleration_noise, rng)


@kernel
def _advance(
    x: float,
    y: float,
    heading: float,
    speed: float,
    acceleration: float,
    speed_draw: float,
    acceleration_draw: float,
    duration: float,
    path: FloatArray,
) -> None:
    applied = acceleration + acceleration_draw * acceleration
    after = next_speed(speed, applied, speed_draw, duration)
    distance = travelled(speed, after, duration)
    path[0, 0], path[0, 1], path[0, 2], path[0, 3] = x, y, heading, speed
    path[1, 0] = x + distance * math.cos(heading)
    path[1, 1] = y + distance * math.sin(heading)
    path[1, 2], path[1, 3] = heading, after


class BasicCar:
    """A point with a speed."""

    def __init__(self, car: Car) -> None:
        """Take the noise from the scenario's car."""
        self._noise = (car.speed_noise, car.acceleration_noise)

    def reset(self, car: CarState) -> None:
        """Put the car at this state."""
        self._car = car

    def draw(self, rng: np.random.Generator) -> Noise:
        """Draw both, so that a car that brakes and one that does not use up the same numbers."""
        return Noise(*_draw(*self._noise, rng))

    def advance(self, acceleration: float, duration: float, noise: Noise) -> FloatArray:
        """Return the two ends of the straight way; see `CarDynamics`."""
        path = np.empty((2, 4))
        _advance(*self._car, acceleration, *noise, duration, path)
        x, y, heading, speed = path[1].tolist()
        self._car = CarState(x, y, heading, speed)
        return path
