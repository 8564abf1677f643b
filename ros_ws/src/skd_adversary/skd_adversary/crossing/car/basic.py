"""The adversary's predictive model of the car (paper, "Generating Kamikaze Trajectories").

The car follows the basic policy with an unknown or known multiplier; what is unknown is a prior, carried as a state
variable by the belief. It has velocity noise and no acceleration noise (paper, "Kamikaze Trajectories": "it only models
the velocity uncertainty").
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.controllers import basic_acceleration
from skd_sim.errors import UsageError
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import draw_relative, next_speed, travelled

from skd_adversary.crossing.crossing import ADVERSARY_X, ADVERSARY_Y, CAR_S, CAR_SPEED, TRIGGER
from skd_adversary.crossing.interfaces import on_road
from skd_adversary.crossing.parts import CarKernels, Sensor, template
from skd_adversary.crossing.sensor import distance, relative_position


@kernel
def start_car(parameters: Any, state: FloatArray, rng: np.random.Generator) -> None:
    """Interface `start_car`."""
    p = parameters
    state[CAR_S] = p.car_start_low + (p.car_start_high - p.car_start_low) * rng.random()
    state[CAR_SPEED] = p.car_start_speed
    state[TRIGGER] = p.trigger_low + (p.trigger_high - p.trigger_low) * rng.random()


@template("on_road")
def advance_car(
    parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray, rng: np.random.Generator
) -> None:
    """Interface `advance_car`."""
    p = parameters
    car_s, speed = state[CAR_S], state[CAR_SPEED]
    _, along = on_road(p, state[ADVERSARY_X], state[ADVERSARY_Y])
    acceleration = basic_acceleration(along - car_s - p.front, state[TRIGGER], p.deceleration)
    speed_after = next_speed(speed, acceleration, draw_relative(p.speed_noise, rng), p.time_step)
    next_state[CAR_S] = car_s + travelled(speed, speed_after, p.time_step)
    next_state[CAR_SPEED] = speed_after
    next_state[TRIGGER] = state[TRIGGER]


@template("on_road")
def foreseen_acceleration(
    parameters: Any,
    state: FloatArray,
    x: float,
    y: float,
    vx_before: float,
    vy_before: float,
    vx: float,
    vy: float,
    car_s: float,
    speed: float,
    change: float,
    change_before: float,
) -> float:
    """Interface `foreseen_acceleration`."""
    _, along = on_road(parameters, x, y)
    return basic_acceleration(along - car_s - parameters.front, state[TRIGGER], parameters.deceleration)


@kernel
def resume_car(parameters: Any, state: FloatArray, redrawn: FloatArray, rng: np.random.Generator) -> None:
    """Interface `resume_car`; the trigger, too."""
    p = parameters
    redrawn[CAR_SPEED] = state[CAR_SPEED] if rng.random() < 0.8 else p.car_start_speed * rng.random()
    redrawn[TRIGGER] = p.trigger_low + (p.trigger_high - p.trigger_low) * rng.random()


@kernel
def redraw_policy(parameters: Any, redrawn: FloatArray, rng: np.random.Generator) -> None:
    """Interface `redraw_policy`: the trigger has been drawn already."""


@kernel(inline=True)
def last_changes(parameters: Any, state: FloatArray) -> tuple[float, float]:
    """Interface `last_changes`: of no matter to a car that has a law."""
    return 0.0, 0.0


KERNELS = CarKernels("basic", 0, start_car, advance_car, foreseen_acceleration, resume_car, redraw_policy, last_changes)

WAITING_REWARD: Final = -0.08
"""m of deviation, for each step after φ's end: what it costs to wait for a car that stops by a law, which does not
come any more, though to look at it once more always seems to pay a little."""


@dataclass(frozen=True)
class CarModel:
    """Predicted policy of the car: brake within C·κ, with C ~ U[multiplier_low, multiplier_high].

    Attributes:
        multiplier_low: least C that the adversary thinks possible.
        multiplier_high: greatest C that it thinks possible; equal to the least where C is known.
        observes_position: whether the adversary senses the relative position (basic car) or the distance only.
    """

    multiplier_low: float
    multiplier_high: float
    observes_position: bool

    def __post_init__(self) -> None:
        if not (0.0 <= self.multiplier_low <= self.multiplier_high < math.inf):
            raise UsageError(f"car model needs 0 ≤ low ≤ high, got {self.multiplier_low:g}, {self.multiplier_high:g}")

    @property
    def kernels(self) -> CarKernels:
        """Kernels of how the predicted car moves."""
        return KERNELS

    @property
    def sensor(self) -> Sensor:
        """Sensor by which the adversary sees the car."""
        return relative_position.SENSOR if self.observes_position else distance.SENSOR

    def parameters(self, scenario: Scenario) -> Mapping[str, Any]:
        """Return noise (relative) and range of the trigger, m: one point where C is known."""
        car = scenario.car
        return {
            "speed_noise": car.speed_noise,
            "trigger_low": self.multiplier_low * car.safe_distance,
            "trigger_high": self.multiplier_high * car.safe_distance,
            "waiting_reward": WAITING_REWARD,
        }


def known_basic_car(multiplier: float) -> CarModel:
    """Return the model of a basic car whose C the adversary knows (paper, "Kamikaze Trajectories")."""
    return CarModel(multiplier, multiplier, observes_position=True)


def unknown_car() -> CarModel:
    """Return the model of a car of which nothing is known: C anywhere over and around the paper's range."""
    return CarModel(0.25, 1.5, observes_position=False)
