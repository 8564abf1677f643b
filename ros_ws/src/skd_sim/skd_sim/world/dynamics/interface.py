"""What the world asks of a car's dynamics, and the choice of one by the scenario."""

from __future__ import annotations

from typing import NamedTuple, Protocol, cast

import numpy as np

from skd_sim.arrays import FloatArray
from skd_sim.options.car_dynamics import DYNAMICS
from skd_sim.options.registry import load
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import CarState


class Noise(NamedTuple):
    """Relative perturbations of a car's motion, drawn once a tick.

    Attributes:
        speed: relative noise of the speed.
        acceleration: relative noise of the acceleration.
    """

    speed: float
    acceleration: float


class CarDynamics(Protocol):
    """A car that can be driven.

    Same start, same commands, same noise: same path, to the last bit.
    """

    def reset(self, car: CarState) -> None:
        """Put the car on the road at this state, rolling freely, and forget everything before."""

    def draw(self, rng: np.random.Generator) -> Noise:
        """Draw the noise of a tick; the same number of draws whatever the car does."""

    def advance(self, acceleration: float, duration: float, noise: Noise) -> FloatArray:
        """Drive on under one command.

        Args:
            acceleration: commanded acceleration, m/s², which the car may follow or not.
            duration: time to drive, s: a control period of the scenario, or a part of it.
            noise: relative noise of the acceleration, and of the speed over this duration.

        Returns:
            n × 4 with n ≥ 2: x, y (m), heading (rad) and speed (m/s) at n uniform times from now to the end of the
            duration. Between two of them the car may be taken to move uniformly.
        """


def make_dynamics(scenario: Scenario) -> CarDynamics:
    """Return the dynamics that the scenario names in `car.dynamics`."""
    # Loaded here: who drives the basic car need not wait for the multi-body model.
    name = scenario.car.dynamics
    return cast(CarDynamics, load(DYNAMICS[name].target, f"car.dynamics {name}")(scenario))
