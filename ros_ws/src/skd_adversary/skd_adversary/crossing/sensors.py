"""What the adversary sees of the car, with Gaussian noise: its distance, or its relative position.

The distance is what is seen of a car of which nothing is known, the relative position what is seen of a basic car
(paper, "Kamikaze Trajectories"). The component across the road says nothing that is not known, the road user's own
place: its likelihood is the same for every state, so the model goes without it. On a curved road the place that was
seen is put on the centre line. Of a car that evades the component across the road and its heading are
seen, too.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Final

import numpy as np
from skd_sim.scenario.road import road_pose, road_position
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import rectangle_distance
from skd_sim.world.state import CarState, FloatArray

from skd_adversary.crossing.interfaces import (
    ADVERSARY_X,
    ADVERSARY_Y,
    CAR_S,
    OFFSET,
    TURNED,
    Pair,
    SensorModel,
    Triple,
    at_distance,
    from_car,
    kernels_in,
    on_road,
    template,
)


@template
def _distance(parameters: Any, state: FloatArray) -> float:
    ahead, left = from_car(parameters, state[ADVERSARY_X], state[ADVERSARY_Y], state[CAR_S])
    return math.sqrt(left * left + ahead * ahead)


class _Distance:
    """A sensor of the distance to the car."""

    @staticmethod
    def sense(scenario: Scenario, own: Pair, car: CarState, rng: np.random.Generator) -> FloatArray:
        """Return the distance at which the car is seen, m; places are (x, y), m."""
        dx, dy = car.x - own[0], car.y - own[1]
        distance = math.sqrt(dx * dx + dy * dy)
        return np.array([distance + scenario.adversary.distance_noise * rng.standard_normal()])

    @template
    def observe(
        parameters: Any, state: FloatArray, action: int, observation: FloatArray, rng: np.random.Generator
    ) -> None:
        """Draw the observed distance between road user and car, m."""
        observation[0] = _distance(parameters, state) + parameters.distance_noise * rng.standard_normal()

    @template(inline=False)
    def likelihood(parameters: Any, state: FloatArray, action: int, observation: FloatArray) -> float:
        """Return the density, up to a factor, of an observed distance (m)."""
        error = (observation[0] - _distance(parameters, state)) / parameters.distance_noise
        return math.exp(-0.5 * error * error)

    @template(inline=False)
    def place_car(
        parameters: Any, state: FloatArray, observation: FloatArray, redrawn: FloatArray, rng: np.random.Generator
    ) -> None:
        """Interface `place_car`: at the observed distance, on the side where the car was believed."""
        distance = observation[0] + parameters.distance_noise * rng.standard_normal()
        x, y = state[ADVERSARY_X], state[ADVERSARY_Y]
        _, along = on_road(parameters, x, y)
        redrawn[CAR_S] = at_distance(parameters, x, y, distance, state[CAR_S] <= along)


DISTANCE = SensorModel("distance", **kernels_in(_Distance))


class _Position:
    """A sensor of the car's relative position along the road."""

    @staticmethod
    def sense(scenario: Scenario, own: Pair, car: CarState, rng: np.random.Generator) -> FloatArray:
        """Return how far beyond the road user, along the road, the car is seen, m; places are (x, y), m."""
        noise = scenario.adversary.position_noise * rng.standard_normal(2)  # of both components
        if scenario.road.straight:
            return np.array([car.y - own[1] + noise[1]])
        line = scenario.road.line
        return np.array([road_position(line, car.x + noise[0], car.y + noise[1])[0] - road_position(line, *own)[0]])

    @template
    def observe(
        parameters: Any, state: FloatArray, action: int, observation: FloatArray, rng: np.random.Generator
    ) -> None:
        """Draw how far beyond the road user the car's reference point is seen, m."""
        _, along = on_road(parameters, state[ADVERSARY_X], state[ADVERSARY_Y])
        observation[0] = state[CAR_S] - along + parameters.position_noise * rng.standard_normal()

    @template(inline=False)
    def likelihood(parameters: Any, state: FloatArray, action: int, observation: FloatArray) -> float:
        """Return the density, up to a factor, of an observed relative position along the road (m)."""
        _, along = on_road(parameters, state[ADVERSARY_X], state[ADVERSARY_Y])
        error = (observation[0] - state[CAR_S] + along) / parameters.position_noise
        return math.exp(-0.5 * error * error)

    @template(inline=False)
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


RELATIVE_POSITION = SensorModel("position", **kernels_in(_Position))


_HEADING_NOISE: Final = 0.1  # rad


@template
def _pose_expected(parameters: Any, state: FloatArray) -> Triple:
    """Return what is seen of the car of a state, without noise."""
    across, along = on_road(parameters, state[ADVERSARY_X], state[ADVERSARY_Y])
    return state[CAR_S] - along, state[OFFSET] - across, state[TURNED]


class _Pose:
    """A sensor of the car's place along and across the road, and of its heading."""

    @staticmethod
    def sense(scenario: Scenario, own: Pair, car: CarState, rng: np.random.Generator) -> FloatArray:
        """Return how far beyond the road user and to its right the car is seen, m, and turned to the right, rad."""
        line, noise = scenario.road.line, scenario.adversary.position_noise
        (along, left), (own_along, own_left) = road_position(line, car.x, car.y), road_position(line, *own)
        turned = math.remainder(road_pose(line, along)[2] - car.heading, math.tau)
        exact = np.array([along - own_along, own_left - left, turned])
        return exact + np.array([noise, noise, _HEADING_NOISE]) * rng.standard_normal(3)

    @template
    def observe(
        parameters: Any, state: FloatArray, action: int, observation: FloatArray, rng: np.random.Generator
    ) -> None:
        """Draw what is seen of the car: see `_pose_sense`."""
        along, aside, turned = _pose_expected(parameters, state)
        observation[0] = along + parameters.position_noise * rng.standard_normal()
        observation[1] = aside + parameters.position_noise * rng.standard_normal()
        observation[2] = turned + _HEADING_NOISE * rng.standard_normal()

    @template(inline=False)
    def likelihood(parameters: Any, state: FloatArray, action: int, observation: FloatArray) -> float:
        """Return the density, up to a factor, of what is seen of the car."""
        along, aside, turned = _pose_expected(parameters, state)
        error = (observation[0] - along) / parameters.position_noise
        error_aside = (observation[1] - aside) / parameters.position_noise
        error_turned = (observation[2] - turned) / _HEADING_NOISE
        return math.exp(-0.5 * (error * error + error_aside * error_aside + error_turned * error_turned))


POSE = replace(RELATIVE_POSITION, name="pose", observation_dim=3, **kernels_in(_Pose))
"""Of a car that evades: its place along the road and across it, and its heading."""
