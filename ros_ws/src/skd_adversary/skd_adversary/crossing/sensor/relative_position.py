"""The relative position of the car, with Gaussian noise: what is seen of a basic car (paper, "Kamikaze Trajectories").

The component across the road says nothing that is not known, the road user's own place: its likelihood is the same for
every state, so the model goes without it. On a curved road the place that was seen is put on the centre line.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.scenario.road import road_position
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import rectangle_distance

from skd_adversary.crossing.crossing import ADVERSARY_X, ADVERSARY_Y, CAR_S
from skd_adversary.crossing.interfaces import from_car, on_road
from skd_adversary.crossing.parts import Sensor, template


def parameters_of(scenario: Scenario) -> Mapping[str, float]:
    """Return the standard deviation of the noise, m."""
    return {"position_noise": scenario.adversary.position_noise}


def sense(
    scenario: Scenario, own: tuple[float, float], car: tuple[float, float], rng: np.random.Generator
) -> FloatArray:
    """Return how far beyond the road user, along the road, the car is seen, m; places are (x, y), m."""
    noise = scenario.adversary.position_noise * rng.standard_normal(2)  # of both components
    if scenario.road.straight:
        return np.array([car[1] - own[1] + noise[1]])
    line = scenario.road.line
    return np.array([road_position(line, car[0] + noise[0], car[1] + noise[1])[0] - road_position(line, *own)[0]])


@template("on_road")
def observe(parameters: Any, state: FloatArray, action: int, observation: FloatArray, rng: np.random.Generator) -> None:
    """Draw how far beyond the road user the car's reference point is seen, m."""
    _, along = on_road(parameters, state[ADVERSARY_X], state[ADVERSARY_Y])
    observation[0] = state[CAR_S] - along + parameters.position_noise * rng.standard_normal()


@template("on_road", inline=False)
def likelihood(parameters: Any, state: FloatArray, action: int, observation: FloatArray) -> float:
    """Return the density, up to a factor, of an observed relative position along the road (m)."""
    _, along = on_road(parameters, state[ADVERSARY_X], state[ADVERSARY_Y])
    error = (observation[0] - state[CAR_S] + along) / parameters.position_noise
    return math.exp(-0.5 * error * error)


@template("on_road", "from_car", inline=False)
def place_car(
    parameters: Any, state: FloatArray, observation: FloatArray, redrawn: FloatArray, rng: np.random.Generator
) -> None:
    """Interface `place_car`: where the observed relative position says; not upon the road user."""
    p = parameters
    x, y = state[ADVERSARY_X], state[ADVERSARY_Y]
    _, along = on_road(p, x, y)
    for _ in range(20):
        noise = parameters.position_noise * rng.standard_normal()
        redrawn[CAR_S] = along + observation[0] + noise
        ahead, left = from_car(p, x, y, redrawn[CAR_S])
        if rectangle_distance(ahead, left, p.front, p.rear, p.half_width) > p.radius:
            break


SENSOR = Sensor("position", parameters_of, sense, observe, likelihood, place_car)
