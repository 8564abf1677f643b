"""The distance to the car, with Gaussian noise: what is seen of a car of which nothing is known (paper)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from skd_sim.compilation import kernel
from skd_sim.encounter.scenario import Scenario

from skd_adversary.model.crossing import CAR_Y, PEDESTRIAN_X, PEDESTRIAN_Y
from skd_adversary.model.parts import Sensor
from skd_adversary.planning.pomdp import FloatArray


def parameters_of(scenario: Scenario) -> Mapping[str, float]:
    """Return the standard deviation of the noise, m."""
    return {"distance_noise": scenario.pedestrian.distance_noise}


def sense(scenario: Scenario, dx: float, dy: float, rng: np.random.Generator) -> FloatArray:
    """Return what is seen of a car at (dx, dy), m, from the road user: its distance."""
    distance = math.sqrt(dx * dx + dy * dy)
    return np.array([distance + scenario.pedestrian.distance_noise * rng.standard_normal()])


@kernel(inline=True)
def _distance(state: FloatArray) -> float:
    dx, dy = state[PEDESTRIAN_X], state[CAR_Y] - state[PEDESTRIAN_Y]
    return math.sqrt(dx * dx + dy * dy)


@kernel(inline=True)
def observe(parameters: Any, state: FloatArray, action: int, observation: FloatArray, rng: np.random.Generator) -> None:
    """Draw the observed distance between road user and car, m."""
    observation[0] = _distance(state) + parameters.distance_noise * rng.standard_normal()


@kernel
def likelihood(parameters: Any, state: FloatArray, action: int, observation: FloatArray) -> float:
    """Return the density, up to a factor, of an observed distance (m)."""
    error = (observation[0] - _distance(state)) / parameters.distance_noise
    return math.exp(-0.5 * error * error)


@kernel
def place_car(
    parameters: Any, state: FloatArray, observation: FloatArray, redrawn: FloatArray, rng: np.random.Generator
) -> None:
    """Slot `place_car`: at the observed distance, on the side where the car was believed."""
    distance = observation[0] + parameters.distance_noise * rng.standard_normal()
    x = state[PEDESTRIAN_X]
    along = math.sqrt(max(0.0, distance * distance - x * x))
    behind = state[CAR_Y] <= state[PEDESTRIAN_Y]
    redrawn[CAR_Y] = state[PEDESTRIAN_Y] - along if behind else state[PEDESTRIAN_Y] + along


SENSOR = Sensor("distance", parameters_of, sense, observe, likelihood, place_car)
