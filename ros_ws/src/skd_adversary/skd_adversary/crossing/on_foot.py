"""Road users on foot: the pedestrian, who moves at one speed or stays (paper, "Safe Trajectories"), and walkers.

Walkers need time to start, to turn and to stop: their velocity changes by so much a tick at most. They have the
pedestrian's six actions, which say where they want to go. Their kinds differ in that limit alone.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import first_contact

from skd_adversary.crossing.parts import USER_ROW, Motion, Own, RoadUserKernels, RoadUserModel, template
from skd_adversary.crossing.path import path_velocities

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
def _pedestrian_velocity(parameters: Any, state: FloatArray, action: int) -> tuple[float, float]:
    """Interface `velocity`: whatever the pedestrian did before."""
    return compass_velocity(parameters, action)


def _pedestrian_parameters_of(scenario: Scenario) -> Mapping[str, float]:
    """Return nothing beyond what every model has."""
    return {}


@kernel(inline=True)
def _pedestrian_start_road_user(parameters: Any, state: FloatArray) -> None:
    """Interface `start_road_user`: there is nothing but the place."""


@kernel(inline=True)
def _pedestrian_settle(parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray) -> None:
    """Interface `settle`: there is nothing but the place."""


@kernel(inline=True)
def _pedestrian_possible(parameters: Any, state: FloatArray, vx: float, vy: float) -> tuple[float, float]:
    """Interface `possible`: its own actions change speed and direction at once, so nothing wanted is refused."""
    return vx, vy


@kernel(inline=True)
def _pedestrian_moving(parameters: Any, state: FloatArray) -> tuple[float, float]:
    """Interface `moving`: whatever it did before."""
    return 0.0, 0.0


@kernel(inline=True)
def _pedestrian_next_velocity(parameters: Any, vx: float, vy: float, action: int) -> tuple[float, float]:
    """Interface `next_velocity`: at once."""
    return compass_velocity(parameters, action)


@kernel(inline=True)
def _pedestrian_next_possible(
    parameters: Any, vx: float, vy: float, wanted_x: float, wanted_y: float
) -> tuple[float, float]:
    """Interface `next_possible`: whatever is wanted."""
    return wanted_x, wanted_y


@kernel(inline=True)
def _pedestrian_pointing(parameters: Any, state: FloatArray, vx: float, vy: float) -> float:
    """Interface `pointing`: a disc points nowhere."""
    return 0.0


@kernel(inline=True)
def _pedestrian_steer(parameters: Any, state: FloatArray, way: int) -> int:
    """Interface `steer`: the ways are the pedestrian's own."""
    return way


@kernel(inline=True)
def _pedestrian_touch(
    parameters: Any, ahead: float, left: float, ahead_after: float, left_after: float, turned: float
) -> float:
    """Interface `touch`: a disc."""
    p = parameters
    return first_contact(ahead, left, ahead_after, left_after, p.front, p.rear, p.half_width, p.radius)


def _no_memory(scenario: Scenario, path: FloatArray) -> Own:
    """Return nothing: it remembers nothing."""
    return 0.0, 0.0


def _still_no_memory(own: Own, vx: float, vy: float) -> Own:
    """Return nothing."""
    return own


def _pedestrian_action(scenario: Scenario, own: Own, action: int) -> tuple[float, float]:
    """Return the velocity of an action, m/s."""
    vx, vy = action_velocity(action, scenario.adversary.speed)
    return scenario.end.crossing * vx, vy


def _as_wanted(scenario: Scenario, own: Own, vx: float, vy: float) -> tuple[float, float]:
    """Return the wanted velocity, m/s."""
    return vx, vy


_PEDESTRIAN_KERNELS = RoadUserKernels(
    "pedestrian",
    ACTION_COUNT,
    STAY,
    0,
    False,
    _pedestrian_start_road_user,
    _pedestrian_velocity,
    _pedestrian_settle,
    _pedestrian_possible,
    _pedestrian_moving,
    _pedestrian_next_velocity,
    _pedestrian_next_possible,
    _pedestrian_pointing,
    _pedestrian_steer,
    _pedestrian_touch,
    LATE,
    EARLY,
)
PEDESTRIAN: Final = RoadUserModel(
    "pedestrian",
    _PEDESTRIAN_KERNELS,
    _pedestrian_parameters_of,
    Motion(_no_memory, _still_no_memory, _pedestrian_action, _as_wanted),
    fastest=12.0,
    height=1.8,
    called={
        "carla": "walker.pedestrian.0001",
        "metadrive": "PEDESTRIAN",
        "openscenario": "pedestrian",
        "osi": "TYPE_PEDESTRIAN",
        "commonroad": "pedestrian",
        "levelxdata": "pedestrian",
    },
)
"""Nobody has run faster than 12.4 m/s (U. Bolt, Berlin 2009, over 20 m)."""


_WALKER_DIM = 2  # of a state: velocity to the East and to the North, m/s


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
def _walker_start_road_user(parameters: Any, state: FloatArray) -> None:
    """Interface `start_road_user`: it comes as φ does in its first step; without φ it stands."""
    p = parameters
    state[USER_ROW] = state[USER_ROW + 1] = 0.0
    if p.path.shape[0] > 1:
        state[USER_ROW] = (p.path[1, 0] - p.path[0, 0]) / p.time_step
        state[USER_ROW + 1] = (p.path[1, 1] - p.path[0, 1]) / p.time_step


@template("USER_ROW")
def _walker_velocity(parameters: Any, state: FloatArray, action: int) -> tuple[float, float]:
    """Interface `velocity`."""
    wanted_x, wanted_y = compass_velocity(parameters, action)
    return nearest_walked(parameters.own_change, state[USER_ROW], state[USER_ROW + 1], wanted_x, wanted_y)


@template("USER_ROW")
def _walker_settle(parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray) -> None:
    """Interface `settle`."""
    next_state[USER_ROW], next_state[USER_ROW + 1] = vx, vy


@template("USER_ROW")
def _walker_possible(parameters: Any, state: FloatArray, vx: float, vy: float) -> tuple[float, float]:
    """Interface `possible`."""
    return nearest_walked(parameters.own_change, state[USER_ROW], state[USER_ROW + 1], vx, vy)


@template("USER_ROW")
def _walker_moving(parameters: Any, state: FloatArray) -> tuple[float, float]:
    """Interface `moving`."""
    return state[USER_ROW], state[USER_ROW + 1]


@kernel(inline=True)
def _walker_next_velocity(parameters: Any, vx: float, vy: float, action: int) -> tuple[float, float]:
    """Interface `next_velocity`."""
    wanted_x, wanted_y = compass_velocity(parameters, action)
    return nearest_walked(parameters.own_change, vx, vy, wanted_x, wanted_y)


@kernel(inline=True)
def _walker_next_possible(
    parameters: Any, vx: float, vy: float, wanted_x: float, wanted_y: float
) -> tuple[float, float]:
    """Interface `next_possible`."""
    return nearest_walked(parameters.own_change, vx, vy, wanted_x, wanted_y)


_WALKER_KERNELS = replace(
    _PEDESTRIAN_KERNELS,
    name="walker",
    own_dim=_WALKER_DIM,
    start_road_user=_walker_start_road_user,
    velocity=_walker_velocity,
    settle=_walker_settle,
    possible=_walker_possible,
    moving=_walker_moving,
    next_velocity=_walker_next_velocity,
    next_possible=_walker_next_possible,
)


def walker(
    name: str, acceleration: float, *, fastest: float, height: float, called: Mapping[str, str] | None = None
) -> RoadUserModel:
    """Return a kind of road user on foot whose velocity changes by an acceleration (m/s²) at most."""
    motion = Motion(
        _walker_first,
        _walker_after,
        functools.partial(_walker_action, acceleration),
        functools.partial(_walker_nearest, acceleration),
    )
    parameters = functools.partial(_walker_parameters_of, acceleration)
    return RoadUserModel(name, _WALKER_KERNELS, parameters, motion, fastest, height, called or {})


def _walker_parameters_of(acceleration: float, scenario: Scenario) -> Mapping[str, Any]:
    """Return by how much its velocity can change in a tick, m/s."""
    return {"own_change": acceleration * scenario.time_step}


def _walker_first(scenario: Scenario, path: FloatArray) -> Own:
    """Return the velocity (East, North), m/s, with which it comes: that of φ's first step."""
    vx, vy = path_velocities(path, 1, scenario.time_step)[0].tolist()
    return vx, vy


def _walker_after(own: Own, vx: float, vy: float) -> Own:
    """Return its velocity after a step: that of the step, m/s."""
    return vx, vy


def _walker_action(acceleration: float, scenario: Scenario, own: Own, action: int) -> tuple[float, float]:
    """Return the velocity of an action, from the velocity before, m/s."""
    vx, vy = action_velocity(action, scenario.adversary.speed)
    return nearest_walked(acceleration * scenario.time_step, *own, vx * scenario.end.crossing, vy)


def _walker_nearest(acceleration: float, scenario: Scenario, own: Own, vx: float, vy: float) -> tuple[float, float]:
    """Return the velocity that comes nearest to a wanted one, m/s."""
    return nearest_walked(acceleration * scenario.time_step, *own, vx, vy)
