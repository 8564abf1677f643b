"""The distance to the car, with Gaussian noise: what is seen of a car of which nothing is known (paper)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.scenario.scenario import Scenario

from skd_adversary.crossing.crossing import ADVERSARY_X, ADVERSARY_Y, CAR_S
from skd_adversary.crossing.interfaces import at_distance, from_car, on_road
from skd_adversary.crossing.parts import Sensor, template


def parameters_of(scenario: Scenario) -> Mapping[str, float]:
    """Return the standard deviation of the noise, m."""
    return {"distance_noise": scenario.adversary.distance_noise}


def sense(
    scenario: Scenario, own: tuple[float, float], car: tuple[float, float], rng: np.random.Generator
) -> FloatArray:
    """Return the distance at which the car is seen, m; places are (x, y), m."""
    dx, dy = car[0] - own[0], car[1] - own[1]
    distance = math.sqrt(dx * dx + dy * dy)
    return np.array([distance + scenario.adversary.distance_noise * rng.standard_normal()])


@template("from_car")
def _distance(parameters: Any, state: FloatArray) -> float:
    ahead, left = from_car(parameters, state[ADVERSARY_X], state[ADVERSARY_Y], state[CAR_S])
    return math.sqrt(left * left + ahead * ahead)


@template("_distance")
def observe(parameters: Any, state: FloatArray, action: int, observation: FloatArray, rng: np.random.Generator) -> None:
    """Draw the observed distance between road user and car, m."""
    observation[0] = _distance(parameters, state) + parameters.distance_noise * rng.standard_normal()


@template("_distance", inline=False)
def likelihood(parameters: Any, state: FloatArray, action: int, observation: FloatArray) -> float:
    """Return the density, up to a factor, of an observed distance (m)."""
    error = (observation[0] - _distance(parameters, state)) / parameters.distance_noise
    return math.exp(-0.5 * error * error)


@template("on_road", "at_distance", inline=False)
def place_car(
    parameters: Any, state: FloatArray, observation: FloatArray, redrawn: FloatArray, rng: np.random.Generator
) -> None:
    """Interface `place_car`: at the observed distance, on the side where the car was believed."""
    distance = observation[0] + parameters.distance_noise * rng.standard_normal()
    x, y = state[ADVERSARY_X], state[ADVERSARY_Y]
    _, along = on_road(parameters, x, y)
    redrawn[CAR_S] = at_distance(parameters, x, y, distance, state[CAR_S] <= along)


SENSOR = Sensor("distance", parameters_of, sense, observe, likelihood, place_car)
