"""Road users on wheels: a box that moves where it points; it speeds up, brakes and steers, and does not jump aside.

It keeps heading and speed from tick to tick. Each tick it brakes, keeps its speed or speeds up, and steers left, not
at all or right; it turns as far as its limits allow, the faster the less. The kinds differ in their limits alone.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import first_contact_of_boxes

from skd_adversary.crossing.on_foot import DIRECTION_EAST, DIRECTION_NORTH, STAY
from skd_adversary.crossing.parts import USER_ROW, Motion, Own, RoadUserKernels, RoadUserModel, template

KEEP, ACCELERATE, BRAKE, LEFT, RIGHT, BRAKE_LEFT, BRAKE_RIGHT = range(7)
ACTION_COUNT = 7
_ANY = tuple(range(ACTION_COUNT))  # full effort is what gets furthest from φ in a given time, to whatever side
_ACCELERATES = (0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_BRAKES = (0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0)
_SIDE = (0.0, 0.0, 0.0, 1.0, -1.0, 1.0, -1.0)  # left is positive
_SAME = 1e-9  # m/s and rad, by rounding
_OWN = 2  # of a state: heading (rad), speed (m/s)


class RidingLimits(NamedTuple):
    """What a kind can do.

    Attributes:
        acceleration: m/s².
        deceleration: m/s².
        lateral: acceleration to the side, m/s².
        turn: the most that it turns in a tick, rad; of one that hardly moves.
        radius: of the tightest circle that it drives, m; 0 if it can turn on the spot.
    """

    acceleration: float
    deceleration: float
    lateral: float
    turn: float
    radius: float


@kernel(inline=True)
def _sharpest(limits: RidingLimits, speed: float, time_step: float) -> float:
    """Return by how much it can turn in a step (rad) at the speed that it then has (m/s)."""
    sharpest = limits.turn
    if limits.turn * speed > limits.lateral * time_step:
        sharpest = limits.lateral * time_step / speed
    if limits.radius > 0.0:
        sharpest = min(sharpest, speed * time_step / limits.radius)
    return sharpest


@kernel(inline=True)
def ridden(
    limits: RidingLimits, heading: float, speed: float, action: int, most: float, time_step: float
) -> tuple[float, float]:
    """Return the velocity (East, North), m/s, over a step.

    Args:
        limits: of its kind.
        heading: before, rad.
        speed: before, m/s.
        action: one of the seven above.
        most: speed that it can reach, m/s.
        time_step: s.
    """
    effort = limits.acceleration * _ACCELERATES[action] - limits.deceleration * _BRAKES[action]
    after = min(max(0.0, speed + time_step * effort), max(most, speed))
    if after < _SAME:  # what rounding leaves of braking to a stand: nobody who stands turns
        after = 0.0
    direction = heading + _SIDE[action] * _sharpest(limits, after, time_step)
    return after * math.cos(direction), after * math.sin(direction)


@kernel(inline=True)
def nearest_ridden(
    limits: RidingLimits, heading: float, speed: float, vx: float, vy: float, most: float, time_step: float
) -> tuple[float, float]:
    """Return the velocity (East, North), m/s, over a step that comes nearest to a wanted one (vx, vy), m/s.

    Between its actions it can do all: it comes as near as it can to the wanted speed, and at that speed turns as far as
    it can to the wanted direction. Arguments as in `ridden`.
    """
    slowest = max(0.0, speed - time_step * limits.deceleration)
    fastest = max(most, speed)
    if speed + time_step * limits.acceleration < fastest:
        fastest = speed + time_step * limits.acceleration
    wanted = math.sqrt(vx * vx + vy * vy)
    cos, sin = math.cos(heading), math.sin(heading)
    turn = math.atan2(cos * vy - sin * vx, cos * vx + sin * vy)  # 0 for who wants to stand
    after = min(max(wanted, slowest), fastest)
    sharpest = _sharpest(limits, after, time_step)
    if abs(after - wanted) <= _SAME and abs(turn) <= sharpest + _SAME:
        return vx, vy
    direction = heading + min(max(turn, -sharpest), sharpest)
    return after * math.cos(direction), after * math.sin(direction)


@kernel(inline=True)
def settled(heading: float, vx: float, vy: float) -> tuple[float, float]:
    """Return heading (rad) and speed (m/s) after a step at a velocity; who stands keeps the heading."""
    speed = math.sqrt(vx * vx + vy * vy)
    return (math.atan2(vy, vx) if speed > 0.0 else heading), speed


@kernel(inline=True)
def _start(path: FloatArray, heading: float, speed: float, time_step: float) -> tuple[float, float]:
    """Return heading (rad) and speed (m/s) with which it comes: those of φ's first step; without φ, those given."""
    if path.shape[0] < 2:
        return heading, speed
    return settled(heading, (path[1, 0] - path[0, 0]) / time_step, (path[1, 1] - path[0, 1]) / time_step)


@kernel(inline=True)
def steered(limits: RidingLimits, crossing: float, heading: float, way: int) -> int:
    """Return the action that leads soonest to one of a pedestrian's ways; see interface `steer`.

    It speeds up where it points about there, turns there, braking where that is behind, and brakes to stay.
    """
    if way == STAY:
        return BRAKE
    cos, sin = math.cos(heading), math.sin(heading)
    east, north = crossing * DIRECTION_EAST[way], DIRECTION_NORTH[way]
    ahead, left = cos * east + sin * north, cos * north - sin * east
    if ahead < 0.0:
        return BRAKE_LEFT if left > 0.0 else BRAKE_RIGHT
    if abs(left) <= math.sin(0.5 * limits.turn):
        return ACCELERATE
    return LEFT if left > 0.0 else RIGHT


@template("USER_ROW")
def start_road_user(parameters: Any, state: FloatArray) -> None:
    """Interface `start_road_user`."""
    p = parameters
    state[USER_ROW], state[USER_ROW + 1] = _start(p.path, p.own_heading, p.own_speed, p.time_step)


@template("USER_ROW")
def velocity(parameters: Any, state: FloatArray, action: int) -> tuple[float, float]:
    """Interface `velocity`."""
    p = parameters
    return ridden(p.own_limits, state[USER_ROW], state[USER_ROW + 1], action, p.adversary_speed, p.time_step)


@template("USER_ROW")
def settle(parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray) -> None:
    """Interface `settle`."""
    next_state[USER_ROW], next_state[USER_ROW + 1] = settled(state[USER_ROW], vx, vy)


@template("USER_ROW")
def possible(parameters: Any, state: FloatArray, vx: float, vy: float) -> tuple[float, float]:
    """Interface `possible`."""
    p = parameters
    return nearest_ridden(p.own_limits, state[USER_ROW], state[USER_ROW + 1], vx, vy, p.adversary_speed, p.time_step)


@template("USER_ROW")
def moving(parameters: Any, state: FloatArray) -> tuple[float, float]:
    """Interface `moving`."""
    return state[USER_ROW + 1] * math.cos(state[USER_ROW]), state[USER_ROW + 1] * math.sin(state[USER_ROW])


@kernel(inline=True)
def next_velocity(parameters: Any, vx: float, vy: float, action: int) -> tuple[float, float]:
    """Interface `next_velocity`."""
    p = parameters
    heading, speed = settled(p.own_heading, vx, vy)
    return ridden(p.own_limits, heading, speed, action, p.adversary_speed, p.time_step)


@kernel(inline=True)
def next_possible(parameters: Any, vx: float, vy: float, wanted_x: float, wanted_y: float) -> tuple[float, float]:
    """Interface `next_possible`."""
    p = parameters
    heading, speed = settled(p.own_heading, vx, vy)
    return nearest_ridden(p.own_limits, heading, speed, wanted_x, wanted_y, p.adversary_speed, p.time_step)


@template("USER_ROW")
def pointing(parameters: Any, state: FloatArray, vx: float, vy: float) -> float:
    """Interface `pointing`."""
    return settled(state[USER_ROW], vx, vy)[0]


@template("USER_ROW")
def steer(parameters: Any, state: FloatArray, way: int) -> int:
    """Interface `steer`."""
    return steered(parameters.own_limits, parameters.crossing, state[USER_ROW], way)


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


KERNELS = RoadUserKernels(
    "wheeled",
    ACTION_COUNT,
    BRAKE,
    _OWN,
    True,
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
    _ANY,
    _ANY,
)


def wheeled(
    name: str, limits: RidingLimits, *, fastest: float, height: float, called: Mapping[str, str] | None = None
) -> RoadUserModel:
    """Return a kind of road user on wheels; see `RoadUserModel`."""
    motion = Motion(_first, _after, functools.partial(_velocity, limits), functools.partial(_nearest, limits))
    parameters = functools.partial(_parameters_of, limits)
    return RoadUserModel(name, KERNELS, parameters, motion, fastest, height, called or {})


def _parameters_of(limits: RidingLimits, scenario: Scenario) -> Mapping[str, Any]:
    """Return limits, half of the box's length and of its width (m), and how it comes where there is no φ."""
    _, half_length, half_width = scenario.adversary.shape
    heading, speed = _arrival(scenario)
    return {
        "own_limits": limits,
        "own_half_length": half_length,
        "own_half_width": half_width,
        "own_heading": heading,
        "own_speed": speed,
    }


def _arrival(scenario: Scenario) -> tuple[float, float]:
    """Return heading (rad) and speed (m/s) with which it comes where there is no φ: as fast as it can, by default."""
    adversary = scenario.adversary
    return adversary.first_heading, adversary.speed if adversary.start_speed is None else adversary.start_speed


def _first(scenario: Scenario, path: FloatArray) -> Own:
    """Return heading (rad) and speed (m/s) with which it comes."""
    return _start(np.ascontiguousarray(path), *_arrival(scenario), scenario.time_step)


def _after(own: Own, vx: float, vy: float) -> Own:
    """Return heading (rad) and speed (m/s) after a step at a velocity, m/s."""
    return settled(own[0], vx, vy)


def _velocity(limits: RidingLimits, scenario: Scenario, own: Own, action: int) -> tuple[float, float]:
    """Return the velocity of an action, from the heading and the speed before, m/s."""
    return ridden(limits, *own, action, scenario.adversary.speed, scenario.time_step)


def _nearest(limits: RidingLimits, scenario: Scenario, own: Own, vx: float, vy: float) -> tuple[float, float]:
    """Return the velocity that comes nearest to a wanted one, m/s."""
    return nearest_ridden(limits, *own, vx, vy, scenario.adversary.speed, scenario.time_step)
