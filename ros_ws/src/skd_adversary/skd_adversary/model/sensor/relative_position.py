"""The relative position of the car, with Gaussian noise: what is seen of a basic car (paper, "Kamikaze Trajectories").

The East component says nothing that is not known, the road user's own x: its likelihood is the same for every state, so
the model goes without it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from skd_sim.compilation import kernel
from skd_sim.encounter.scenario import Scenario
from skd_sim.geometry import rectangle_distance

from skd_adversary.model.crossing import CAR_Y, PEDESTRIAN_X, PEDESTRIAN_Y
from skd_adversary.model.parts import Sensor
from skd_adversary.planning.pomdp import FloatArray


def parameters_of(scenario: Scenario) -> Mapping[str, float]:
    """Return the standard deviation of the noise, m."""
    return {"position_noise": scenario.pedestrian.position_noise}


def sense(scenario: Scenario, dx: float, dy: float, rng: np.random.Generator) -> FloatArray:
    """Return what is seen of a car at (dx, dy), m, from the road user: how far North of him it is."""
    noise = scenario.pedestrian.position_noise * rng.standard_normal(2)  # of both components
    return np.array([dy + noise[1]])


@kernel(inline=True)
def observe(parameters: Any, state: FloatArray, action: int, observation: FloatArray, rng: np.random.Generator) -> None:
    """Draw how far North of the road user the car's reference point is seen, m."""
    observation[0] = state[CAR_Y] - state[PEDESTRIAN_Y] + parameters.position_noise * rng.standard_normal()


@kernel
def likelihood(parameters: Any, state: FloatArray, action: int, observation: FloatArray) -> float:
    """Return the density, up to a factor, of an observed North component of the relative position (m)."""
    error = (observation[0] - state[CAR_Y] + state[PEDESTRIAN_Y]) / parameters.position_noise
    return math.exp(-0.5 * error * error)


@kernel
def place_car(
    parameters: Any, state: FloatArray, observation: FloatArray, redrawn: FloatArray, rng: np.random.Generator
) -> None:
    """Slot `place_car`: where the observed relative position says; not upon the road user."""
    p = parameters
    for _ in range(20):
        noise = parameters.position_noise * rng.standard_normal()
        redrawn[CAR_Y] = state[PEDESTRIAN_Y] + observation[0] + noise
        ahead, left = state[PEDESTRIAN_Y] - redrawn[CAR_Y], -state[PEDESTRIAN_X]
        if rectangle_distance(ahead, left, p.front, p.rear, p.half_width) > p.radius:
            break


SENSOR = Sensor("position", parameters_of, sense, observe, likelihood, place_car)
