"""The pedestrian: moves at one speed, or stays (paper, section "Safe Trajectories")."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import first_contact

from skd_adversary.crossing.parts import RoadUserKernels, RoadUserModel
from skd_adversary.crossing.safe_path import path_velocities

# Actions, in the order of the paper
NORTH, SOUTH, EAST, NORTH_EAST, SOUTH_EAST, STAY = range(6)
ACTION_COUNT = 6
LATE, EARLY = (STAY, SOUTH, SOUTH_EAST), (EAST, NORTH_EAST, NORTH)
AS_PHI = ACTION_COUNT
"""As φ (objective `deviation` only): the displacement that φ makes in the present tick, none after its end."""
_DIAGONAL = math.sqrt(0.5)
DIRECTION_EAST = (0.0, 0.0, 1.0, _DIAGONAL, _DIAGONAL, 0.0)
DIRECTION_NORTH = (1.0, -1.0, 0.0, _DIAGONAL, -_DIAGONAL, 0.0)


@kernel(inline=True)
def action_velocity(action: int, speed: float) -> tuple[float, float]:
    """Return the pedestrian's velocity (East, North), m/s, under an action."""
    return speed * DIRECTION_EAST[action], speed * DIRECTION_NORTH[action]


@kernel(inline=True)
def compass_velocity(parameters: Any, action: int) -> tuple[float, float]:
    """Return the same of an adversary that crosses to the right, or, with East and West exchanged, to the left."""
    vx, vy = action_velocity(action, parameters.adversary_speed)
    return parameters.crossing * vx, vy


@kernel(inline=True)
def velocity(parameters: Any, state: FloatArray, action: int) -> tuple[float, float]:
    """Interface `velocity`: whatever the pedestrian did before."""
    return compass_velocity(parameters, action)


def parameters_of(scenario: Scenario) -> Mapping[str, float]:
    """Return nothing beyond what every model has."""
    return {}


@kernel(inline=True)
def start_road_user(parameters: Any, state: FloatArray) -> None:
    """Interface `start_road_user`: there is nothing but the place."""


@kernel(inline=True)
def settle(parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray) -> None:
    """Interface `settle`: there is nothing but the place."""


@kernel(inline=True)
def possible(parameters: Any, state: FloatArray, vx: float, vy: float) -> tuple[float, float]:
    """Interface `possible`: its own actions change speed and direction at once, so nothing wanted is refused."""
    return vx, vy


@kernel(inline=True)
def moving(parameters: Any, state: FloatArray) -> tuple[float, float]:
    """Interface `moving`: whatever it did before."""
    return 0.0, 0.0


@kernel(inline=True)
def next_velocity(parameters: Any, vx: float, vy: float, action: int) -> tuple[float, float]:
    """Interface `next_velocity`: at once."""
    return compass_velocity(parameters, action)


@kernel(inline=True)
def next_possible(parameters: Any, vx: float, vy: float, wanted_x: float, wanted_y: float) -> tuple[float, float]:
    """Interface `next_possible`: whatever is wanted."""
    return wanted_x, wanted_y


@kernel(inline=True)
def pointing(parameters: Any, state: FloatArray, vx: float, vy: float) -> float:
    """Interface `pointing`: a disc points nowhere."""
    return 0.0


@kernel(inline=True)
def steer(parameters: Any, state: FloatArray, way: int) -> int:
    """Interface `steer`: the ways are the pedestrian's own."""
    return way


@kernel(inline=True)
def touch(parameters: Any, ahead: float, left: float, ahead_after: float, left_after: float, turned: float) -> float:
    """Interface `touch`: a disc."""
    p = parameters
    return first_contact(ahead, left, ahead_after, left_after, p.front, p.rear, p.half_width, p.radius)


def velocities(scenario: Scenario) -> FloatArray:
    """Return the velocity (East, North), m/s, that each action asks for, action_count × 2."""
    own = np.array([action_velocity(action, scenario.adversary.speed) for action in range(ACTION_COUNT)])
    own[:, 0] *= scenario.end.crossing
    return own


def choices(scenario: Scenario, path: FloatArray, way: FloatArray) -> FloatArray:
    """Return the velocities of all actions, whatever the way; see `RoadUserModel`."""
    own = velocities(scenario)
    return np.broadcast_to(own, (len(way) - 1, *own.shape))


def as_phi(scenario: Scenario, path: FloatArray, way: FloatArray) -> FloatArray:
    """Return φ's velocities, whatever the way; see `RoadUserModel`."""
    return path_velocities(path, len(way) - 1, scenario.time_step)


KERNELS = RoadUserKernels(
    "pedestrian",
    ACTION_COUNT,
    STAY,
    0,
    False,
    start_road_user,
    velocity,
    settle,
    possible,
    moving,
    next_velocity,
    next_possible,
    pointing,
    steer,
    touch,
    LATE,
    EARLY,
)
ROAD_USER = RoadUserModel(
    "pedestrian", KERNELS, parameters_of, choices, as_phi, fastest=12.0, height=1.8,
    called={
        "carla": "walker.pedestrian.0001",
        "metadrive": "PEDESTRIAN",
        "openscenario": "pedestrian",
        "osi": "TYPE_PEDESTRIAN",
        "commonroad": "pedestrian",
        "levelxdata": "pedestrian",
    },
)  # fmt: skip
"""Nobody has run faster than 12.4 m/s (U. Bolt, Berlin 2009, over 20 m)."""
