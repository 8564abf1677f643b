"""The cyclist: a box that rides where it points; it speeds up, brakes and steers, and does not jump aside.

It keeps heading and speed from tick to tick. Each tick it brakes, keeps its speed or pedals, and steers left, not
at all or right; it turns as far as the lean allows, the faster the less. docs/decisions.md says why these numbers.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.encounter.scenario import Scenario
from skd_sim.geometry.contact import first_contact_of_boxes
from skd_sim.kernels.compilation import kernel

from skd_adversary.model.interfaces import USER_ROW
from skd_adversary.model.parts import RoadUserModel, template
from skd_adversary.model.road_user import pedestrian
from skd_adversary.model.safe_path import path_velocities

KEEP, ACCELERATE, BRAKE, LEFT, RIGHT, BRAKE_LEFT, BRAKE_RIGHT = range(7)
ACTION_COUNT = 7
ACCELERATION: Final = 1.0  # m/s²
DECELERATION: Final = 3.0  # m/s²
LATERAL_ACCELERATION: Final = 3.0  # m/s²: a lean of 17°
SHARPEST_TURN: Final = math.pi / 6.0  # rad in a tick, of one who hardly moves
_EFFORT = (0.0, ACCELERATION, -DECELERATION, 0.0, 0.0, -DECELERATION, -DECELERATION)
_SIDE = (0.0, 0.0, 0.0, 1.0, -1.0, 1.0, -1.0)  # left is positive
_ABOUT_THERE = math.sin(0.5 * SHARPEST_TURN)
_SAME = 1e-9  # m/s and rad, by rounding
_OWN = 2  # of a state: heading (rad), speed (m/s)


@kernel(inline=True)
def _sharpest(speed: float, time_step: float) -> float:
    """Return by how much it can turn in a step (rad) at the speed that it then has (m/s)."""
    if SHARPEST_TURN * speed > LATERAL_ACCELERATION * time_step:
        return LATERAL_ACCELERATION * time_step / speed
    return SHARPEST_TURN


@kernel(inline=True)
def ridden(heading: float, speed: float, action: int, most: float, time_step: float) -> tuple[float, float]:
    """Return the velocity (East, North), m/s, over a step.

    Args:
        heading: before, rad.
        speed: before, m/s.
        action: of the cyclist.
        most: speed that it can reach, m/s.
        time_step: s.
    """
    after = min(max(0.0, speed + time_step * _EFFORT[action]), max(most, speed))
    direction = heading + _SIDE[action] * _sharpest(after, time_step)
    return after * math.cos(direction), after * math.sin(direction)


@kernel(inline=True)
def nearest_ridden(
    heading: float, speed: float, vx: float, vy: float, most: float, time_step: float
) -> tuple[float, float]:
    """Return the velocity (East, North), m/s, over a step that comes nearest to a wanted one (vx, vy), m/s.

    Between its actions it can do all: it comes as near as it can to the wanted speed, and at that speed turns as far as
    it can to the wanted direction. Arguments as in `ridden`.
    """
    slowest = max(0.0, speed - time_step * DECELERATION)
    fastest = max(most, speed)
    if speed + time_step * ACCELERATION < fastest:
        fastest = speed + time_step * ACCELERATION
    wanted = math.sqrt(vx * vx + vy * vy)
    cos, sin = math.cos(heading), math.sin(heading)
    turn = math.atan2(cos * vy - sin * vx, cos * vx + sin * vy)  # 0 for who wants to stand
    after = min(max(wanted, slowest), fastest)
    sharpest = _sharpest(after, time_step)
    if abs(after - wanted) <= _SAME and abs(turn) <= sharpest + _SAME:
        return vx, vy
    direction = heading + min(max(turn, -sharpest), sharpest)
    return after * math.cos(direction), after * math.sin(direction)


@kernel(inline=True)
def _settled(heading: float, vx: float, vy: float) -> tuple[float, float]:
    """Return heading (rad) and speed (m/s) after a step at a velocity; who stands keeps the heading."""
    speed = math.sqrt(vx * vx + vy * vy)
    return (math.atan2(vy, vx) if speed > 0.0 else heading), speed


def parameters_of(scenario: Scenario) -> Mapping[str, float]:
    """Return half of the box's length and of its width, m."""
    _, half_length, half_width = scenario.adversary.shape
    return {"own_half_length": half_length, "own_half_width": half_width}


@kernel(inline=True)
def _start(path: FloatArray, most: float, time_step: float) -> tuple[float, float]:
    """Return heading (rad) and speed (m/s) with which it comes: those of φ's first step; at full speed without φ."""
    if path.shape[0] < 2:
        return 0.0, most
    return _settled(0.0, (path[1, 0] - path[0, 0]) / time_step, (path[1, 1] - path[0, 1]) / time_step)


@template("USER_ROW")
def start_road_user(parameters: Any, state: FloatArray) -> None:
    """Interface `start_road_user`."""
    p = parameters
    state[USER_ROW], state[USER_ROW + 1] = _start(p.path, p.adversary_speed, p.time_step)


@template("USER_ROW")
def velocity(parameters: Any, state: FloatArray, action: int) -> tuple[float, float]:
    """Interface `velocity`."""
    return ridden(state[USER_ROW], state[USER_ROW + 1], action, parameters.adversary_speed, parameters.time_step)


@template("USER_ROW")
def settle(parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray) -> None:
    """Interface `settle`."""
    next_state[USER_ROW], next_state[USER_ROW + 1] = _settled(state[USER_ROW], vx, vy)


@template("USER_ROW")
def possible(parameters: Any, state: FloatArray, vx: float, vy: float) -> tuple[float, float]:
    """Interface `possible`."""
    p = parameters
    return nearest_ridden(state[USER_ROW], state[USER_ROW + 1], vx, vy, p.adversary_speed, p.time_step)


@template("USER_ROW")
def pointing(parameters: Any, state: FloatArray, vx: float, vy: float) -> float:
    """Interface `pointing`."""
    return _settled(state[USER_ROW], vx, vy)[0]


@template("USER_ROW")
def steer(parameters: Any, state: FloatArray, way: int) -> int:
    """Interface `steer`: pedal where it points about there; turn there, braking where that is behind; brake to stay."""
    if way == pedestrian.STAY:
        return BRAKE
    cos, sin = math.cos(state[USER_ROW]), math.sin(state[USER_ROW])
    east, north = parameters.crossing * pedestrian.DIRECTION_EAST[way], pedestrian.DIRECTION_NORTH[way]
    ahead, left = cos * east + sin * north, cos * north - sin * east
    if ahead < 0.0:
        return BRAKE_LEFT if left > 0.0 else BRAKE_RIGHT
    if abs(left) <= _ABOUT_THERE:
        return ACCELERATE
    return LEFT if left > 0.0 else RIGHT


@kernel(inline=True)
def touch(parameters: Any, ahead: float, left: float, ahead_after: float, left_after: float, turned: float) -> float:
    """Interface `touch`: two boxes."""
    p = parameters
    return first_contact_of_boxes(
        ahead,
        left,
        ahead_after,
        left_after,
        turned,
        p.front,
        p.rear,
        p.half_width,
        p.own_half_length,
        p.own_half_width,
    )


def choices(scenario: Scenario, path: FloatArray, way: FloatArray) -> FloatArray:
    """Return the velocities of all actions, from the heading and the speed of the step before; see `RoadUserModel`."""
    step, most = scenario.time_step, scenario.adversary.speed
    found = np.empty((len(way) - 1, ACTION_COUNT, 2))
    for tick, (heading, speed) in enumerate(_ridden_so_far(scenario, path, way)):
        found[tick] = [ridden(heading, speed, action, most, step) for action in range(ACTION_COUNT)]
    return found


def as_phi(scenario: Scenario, path: FloatArray, way: FloatArray) -> FloatArray:
    """Return its velocities as φ, or as near to that as it can, in each tick of a way; see `RoadUserModel`."""
    step, most = scenario.time_step, scenario.adversary.speed
    wanted = path_velocities(path, len(way) - 1, step)
    before = _ridden_so_far(scenario, path, way)
    ridden = [nearest_ridden(*own, vx, vy, most, step) for own, (vx, vy) in zip(before, wanted.tolist(), strict=True)]
    return np.array(ridden).reshape(-1, 2)


def _ridden_so_far(scenario: Scenario, path: FloatArray, way: FloatArray) -> Iterator[tuple[float, float]]:
    """Yield heading (rad) and speed (m/s) at the begin of each tick of a way (n × 2, m)."""
    heading, speed = _start(np.ascontiguousarray(path), scenario.adversary.speed, scenario.time_step)
    for vx, vy in (np.diff(way, axis=0) / scenario.time_step).tolist():
        yield heading, speed
        heading, speed = _settled(heading, vx, vy)


ROAD_USER = RoadUserModel(
    "cyclist",
    ACTION_COUNT,
    BRAKE,
    parameters_of,
    _OWN,
    start_road_user,
    velocity,
    settle,
    possible,
    pointing,
    steer,
    touch,
    choices,
    as_phi,
)
