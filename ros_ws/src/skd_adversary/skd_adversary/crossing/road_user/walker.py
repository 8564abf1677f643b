"""Road users on foot who need time to start, to turn and to stop: their velocity changes by so much a tick at most.

They have the pedestrian's six actions, which say where they want to go. The kinds differ in their limit alone.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import Any

from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.scenario import Scenario

from skd_adversary.crossing.interfaces import USER_ROW
from skd_adversary.crossing.parts import Motion, Own, RoadUserKernels, RoadUserModel, template
from skd_adversary.crossing.road_user import pedestrian
from skd_adversary.crossing.road_user.motion import road_user
from skd_adversary.crossing.road_user.pedestrian import ACTION_COUNT, STAY, compass_velocity
from skd_adversary.crossing.safe_path import path_velocities

_OWN = 2  # of a state: velocity to the East and to the North, m/s


@kernel(inline=True)
def nearest_walked(most: float, vx: float, vy: float, wanted_x: float, wanted_y: float) -> tuple[float, float]:
    """Return the velocity (East, North), m/s, after a step that comes nearest to a wanted one.

    Args:
        most: by which it can change in the step, m/s.
        vx: before, m/s.
        vy: likewise.
        wanted_x: m/s.
        wanted_y: likewise.
    """
    dx, dy = wanted_x - vx, wanted_y - vy
    change = math.sqrt(dx * dx + dy * dy)
    if change <= most:
        return wanted_x, wanted_y
    return vx + most / change * dx, vy + most / change * dy


@template("USER_ROW")
def start_road_user(parameters: Any, state: FloatArray) -> None:
    """Interface `start_road_user`: it comes as φ does in its first step; without φ it stands."""
    p = parameters
    state[USER_ROW] = state[USER_ROW + 1] = 0.0
    if p.path.shape[0] > 1:
        state[USER_ROW] = (p.path[1, 0] - p.path[0, 0]) / p.time_step
        state[USER_ROW + 1] = (p.path[1, 1] - p.path[0, 1]) / p.time_step


@template("USER_ROW")
def velocity(parameters: Any, state: FloatArray, action: int) -> tuple[float, float]:
    """Interface `velocity`."""
    wanted_x, wanted_y = compass_velocity(parameters, action)
    return nearest_walked(parameters.own_change, state[USER_ROW], state[USER_ROW + 1], wanted_x, wanted_y)


@template("USER_ROW")
def settle(parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray) -> None:
    """Interface `settle`."""
    next_state[USER_ROW], next_state[USER_ROW + 1] = vx, vy


@template("USER_ROW")
def possible(parameters: Any, state: FloatArray, vx: float, vy: float) -> tuple[float, float]:
    """Interface `possible`."""
    return nearest_walked(parameters.own_change, state[USER_ROW], state[USER_ROW + 1], vx, vy)


@template("USER_ROW")
def moving(parameters: Any, state: FloatArray) -> tuple[float, float]:
    """Interface `moving`."""
    return state[USER_ROW], state[USER_ROW + 1]


@kernel(inline=True)
def next_velocity(parameters: Any, vx: float, vy: float, action: int) -> tuple[float, float]:
    """Interface `next_velocity`."""
    wanted_x, wanted_y = compass_velocity(parameters, action)
    return nearest_walked(parameters.own_change, vx, vy, wanted_x, wanted_y)


@kernel(inline=True)
def next_possible(parameters: Any, vx: float, vy: float, wanted_x: float, wanted_y: float) -> tuple[float, float]:
    """Interface `next_possible`."""
    return nearest_walked(parameters.own_change, vx, vy, wanted_x, wanted_y)


KERNELS = RoadUserKernels(
    "walker",
    ACTION_COUNT,
    STAY,
    _OWN,
    False,
    start_road_user,
    velocity,
    settle,
    possible,
    moving,
    next_velocity,
    next_possible,
    pedestrian.pointing,
    pedestrian.steer,
    pedestrian.touch,
    pedestrian.LATE,
    pedestrian.EARLY,
)


def walker(name: str, acceleration: float, *, fastest: float, height: float) -> RoadUserModel:
    """Return a kind of road user on foot whose velocity changes by an acceleration (m/s²) at most."""
    motion = Motion(
        _first, _after, functools.partial(_velocity, acceleration), functools.partial(_nearest, acceleration)
    )
    return road_user(name, KERNELS, functools.partial(_parameters_of, acceleration), motion, fastest, height)


def _parameters_of(acceleration: float, scenario: Scenario) -> Mapping[str, Any]:
    """Return by how much its velocity can change in a tick, m/s."""
    return {"own_change": acceleration * scenario.time_step}


def _first(scenario: Scenario, path: FloatArray) -> Own:
    """Return the velocity (East, North), m/s, with which it comes: that of φ's first step."""
    vx, vy = path_velocities(path, 1, scenario.time_step)[0].tolist()
    return vx, vy


def _after(own: Own, vx: float, vy: float) -> Own:
    """Return its velocity after a step: that of the step, m/s."""
    return vx, vy


def _velocity(acceleration: float, scenario: Scenario, own: Own, action: int) -> tuple[float, float]:
    """Return the velocity of an action, from the velocity before, m/s."""
    vx, vy = pedestrian.action_velocity(action, scenario.adversary.speed)
    return nearest_walked(acceleration * scenario.time_step, *own, vx * scenario.end.crossing, vy)


def _nearest(acceleration: float, scenario: Scenario, own: Own, vx: float, vy: float) -> tuple[float, float]:
    """Return the velocity that comes nearest to a wanted one, m/s."""
    return nearest_walked(acceleration * scenario.time_step, *own, vx, vy)
