"""The kinds of road user that the adversary can be: on foot, and on wheels, each with its limits and its names.

The pedestrian moves at one speed or stays (paper, "Safe Trajectories"). Walkers need time to start, turn and stop:
their velocity changes by so much a tick at most. Both have the pedestrian's six actions, which say where they want to
go. Who is on wheels is a box that moves where it points. It keeps heading and speed from tick to tick; each tick it
brakes, keeps its speed or speeds up, and steers left, not at all or right, the faster the less. Where the limits are
from: docs/decisions.md (4). Kinds of installed packages are registered (`skd_sim.scenario.road_user`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from skd_sim.errors import UsageError
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.road_user import ROAD_USERS
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import first_contact, first_contact_of_boxes
from skd_sim.world.state import FloatArray, Pair

from skd_adversary.crossing.interfaces import USER_ROW, RoadUserKernels, RoadUserModel, template

# Actions on foot, in the order of the paper
NORTH, SOUTH, EAST, NORTH_EAST, SOUTH_EAST, STAY = range(6)
ACTION_COUNT = 6
AS_PHI = ACTION_COUNT
"""As φ (objective `deviation` only): the displacement that φ makes in the present tick, none after its end."""
_DIAGONAL = math.sqrt(0.5)
DIRECTION_EAST = (0.0, 0.0, 1.0, _DIAGONAL, _DIAGONAL, 0.0)
DIRECTION_NORTH = (1.0, -1.0, 0.0, _DIAGONAL, -_DIAGONAL, 0.0)


# --- the pedestrian


@kernel(inline=True)
def action_velocity(action: int, speed: float) -> Pair:
    """Return the pedestrian's velocity (East, North), m/s, under an action."""
    return speed * DIRECTION_EAST[action], speed * DIRECTION_NORTH[action]


@kernel(inline=True)
def compass_velocity(parameters: Any, action: int) -> Pair:
    """Return the same of an adversary that crosses to the right, or, with East and West exchanged, to the left."""
    vx, vy = action_velocity(action, parameters.adversary_speed)
    return parameters.crossing * vx, vy


class _Pedestrian(RoadUserKernels):
    """A pedestrian: walks at one speed, or stands."""

    name = "pedestrian"
    action_count, rest = ACTION_COUNT, STAY
    late, early = (STAY, SOUTH, SOUTH_EAST), (EAST, NORTH_EAST, NORTH)

    @kernel(inline=True)
    def start_road_user(parameters: Any, state: FloatArray) -> None:
        pass

    @kernel(inline=True)
    def velocity(parameters: Any, state: FloatArray, action: int) -> Pair:
        return compass_velocity(parameters, action)

    @kernel(inline=True)
    def settle(parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray) -> None:
        pass

    @kernel(inline=True)
    def possible(parameters: Any, state: FloatArray, vx: float, vy: float) -> Pair:
        return vx, vy

    @kernel(inline=True)
    def moving(parameters: Any, state: FloatArray) -> Pair:
        return 0.0, 0.0

    @kernel(inline=True)
    def next_velocity(parameters: Any, vx: float, vy: float, action: int) -> Pair:
        return compass_velocity(parameters, action)

    @kernel(inline=True)
    def next_possible(parameters: Any, vx: float, vy: float, x: float, y: float) -> Pair:
        return x, y

    @kernel(inline=True)
    def pointing(parameters: Any, state: FloatArray, vx: float, vy: float) -> float:
        return 0.0

    @kernel(inline=True)
    def steer(parameters: Any, state: FloatArray, direction: int) -> int:
        return direction

    @kernel(inline=True)
    def touch(parameters: Any, before: Pair, after: Pair, turned: float) -> float:
        p = parameters
        return first_contact(before, after, (p.front, p.rear, p.half_width), p.radius)


_FORMATS: Final = ("carla", "metadrive", "openscenario", "osi", "commonroad", "levelxdata")


def _named(*names: str) -> dict[str, str]:
    """Return what each of `_FORMATS` calls a kind; empty where a format has no word for it."""
    return {one: name for one, name in zip(_FORMATS, names, strict=True) if name}


# --- walkers, whose part of a state is their velocity to the East and to the North, m/s


@kernel(inline=True)
def nearest_walked(most: float, vx: float, vy: float, target_x: float, target_y: float) -> Pair:
    """Return the velocity after a step that comes nearest to a requested one; it changes by `most` at most, m/s."""
    dx, dy = target_x - vx, target_y - vy
    change = math.sqrt(dx * dx + dy * dy)
    if change <= most:
        return target_x, target_y
    return vx + most / change * dx, vy + most / change * dy


class _Walker(_Pedestrian):
    """A pedestrian whose velocity changes at a limited rate."""

    name, own_dim = "walker", 2

    @template
    def start_road_user(parameters: Any, state: FloatArray) -> None:
        """It comes as φ does in its first step; without φ it stands."""
        p = parameters
        state[USER_ROW] = state[USER_ROW + 1] = 0.0
        if p.path.shape[0] > 1:
            state[USER_ROW] = (p.path[1, 0] - p.path[0, 0]) / p.time_step
            state[USER_ROW + 1] = (p.path[1, 1] - p.path[0, 1]) / p.time_step

    @template
    def velocity(parameters: Any, state: FloatArray, action: int) -> Pair:
        x, y = compass_velocity(parameters, action)
        return nearest_walked(parameters.own_change, state[USER_ROW], state[USER_ROW + 1], x, y)

    @template
    def settle(parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray) -> None:
        next_state[USER_ROW], next_state[USER_ROW + 1] = vx, vy

    @template
    def possible(parameters: Any, state: FloatArray, vx: float, vy: float) -> Pair:
        return nearest_walked(parameters.own_change, state[USER_ROW], state[USER_ROW + 1], vx, vy)

    @template
    def moving(parameters: Any, state: FloatArray) -> Pair:
        return state[USER_ROW], state[USER_ROW + 1]

    @kernel(inline=True)
    def next_velocity(parameters: Any, vx: float, vy: float, action: int) -> Pair:
        x, y = compass_velocity(parameters, action)
        return nearest_walked(parameters.own_change, vx, vy, x, y)

    @kernel(inline=True)
    def next_possible(parameters: Any, vx: float, vy: float, x: float, y: float) -> Pair:
        return nearest_walked(parameters.own_change, vx, vy, x, y)


def walker(name: str, acceleration: float, **about: Any) -> RoadUserModel:
    """Return a kind of road user on foot whose velocity changes by an acceleration (m/s²) at most.

    Args:
        name: of the kind.
        acceleration: m/s².
        about: `fastest`, `height`, and perhaps `mass` and `names` of a `RoadUserModel`.
    """
    return RoadUserModel(name, _Walker, lambda scenario: {"own_change": acceleration * scenario.time_step}, **about)


# --- on wheels, whose part of a state is heading (rad) and speed (m/s)

KEEP, ACCELERATE, BRAKE, LEFT, RIGHT, BRAKE_LEFT, BRAKE_RIGHT = range(7)
_ACCELERATES = (0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_BRAKES = (0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0)
_SIDE = (0.0, 0.0, 0.0, 1.0, -1.0, 1.0, -1.0)  # left is positive
_SAME = 1e-9  # m/s and rad, by rounding
_TURN = math.pi / 6.0  # rad, the most that anything on wheels turns in a tick


class RidingLimits(NamedTuple):
    """What a kind on wheels can do.

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
    turn: float = _TURN
    radius: float = 0.0


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
def ridden(limits: RidingLimits, heading: float, speed: float, action: int, most: float, time_step: float) -> Pair:
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
    if after < _SAME:  # rounding after a stop: a road user at rest does not turn
        after = 0.0
    direction = heading + _SIDE[action] * _sharpest(limits, after, time_step)
    return after * math.cos(direction), after * math.sin(direction)


@kernel(inline=True)
def nearest_ridden(
    limits: RidingLimits, heading: float, speed: float, vx: float, vy: float, most: float, time_step: float
) -> Pair:
    """Return the velocity (East, North), m/s, over a step that comes nearest to a requested one (vx, vy), m/s.

    Between its actions it can do all: it comes as near as it can to the requested speed, and at that speed turns as far
    as it can to the requested direction. Arguments as in `ridden`.
    """
    slowest = max(0.0, speed - time_step * limits.deceleration)
    fastest = max(most, speed)
    if speed + time_step * limits.acceleration < fastest:
        fastest = speed + time_step * limits.acceleration
    target = math.sqrt(vx * vx + vy * vy)
    cos, sin = math.cos(heading), math.sin(heading)
    turn = math.atan2(cos * vy - sin * vx, cos * vx + sin * vy)  # 0 for who wants to stand
    after = min(max(target, slowest), fastest)
    sharpest = _sharpest(limits, after, time_step)
    if abs(after - target) <= _SAME and abs(turn) <= sharpest + _SAME:
        return vx, vy
    direction = heading + min(max(turn, -sharpest), sharpest)
    return after * math.cos(direction), after * math.sin(direction)


@kernel(inline=True)
def settled(heading: float, vx: float, vy: float) -> Pair:
    """Return heading (rad) and speed (m/s) after a step at a velocity; who stands keeps the heading."""
    speed = math.sqrt(vx * vx + vy * vy)
    return (math.atan2(vy, vx) if speed > 0.0 else heading), speed


@kernel(inline=True)
def _arrived(path: FloatArray, heading: float, speed: float, time_step: float) -> Pair:
    """Return heading (rad) and speed (m/s) with which it comes: those of φ's first step; without φ, those given."""
    if path.shape[0] < 2:
        return heading, speed
    return settled(heading, (path[1, 0] - path[0, 0]) / time_step, (path[1, 1] - path[0, 1]) / time_step)


@kernel(inline=True)
def steered(limits: RidingLimits, crossing: float, heading: float, direction: int) -> int:
    """Return the action that leads soonest to one of a pedestrian's directions.

    It speeds up where it points about there, turns there, braking where that is behind, and brakes to stay.
    """
    if direction == STAY:
        return BRAKE
    cos, sin = math.cos(heading), math.sin(heading)
    east, north = crossing * DIRECTION_EAST[direction], DIRECTION_NORTH[direction]
    ahead, left = cos * east + sin * north, cos * north - sin * east
    if ahead < 0.0:
        return BRAKE_LEFT if left > 0.0 else BRAKE_RIGHT
    if abs(left) <= math.sin(0.5 * limits.turn):
        return ACCELERATE
    return LEFT if left > 0.0 else RIGHT


class _Wheeled(RoadUserKernels):
    """A road user on wheels: moves in the direction of its heading."""

    name, own_dim, box = "wheeled", 2, True
    action_count, rest = 7, BRAKE
    late = early = tuple(range(7))  # full effort is what gets furthest from φ in a given time, to whatever side

    @template
    def start_road_user(parameters: Any, state: FloatArray) -> None:
        p = parameters
        state[USER_ROW], state[USER_ROW + 1] = _arrived(p.path, p.own_heading, p.own_speed, p.time_step)

    @template
    def velocity(parameters: Any, state: FloatArray, action: int) -> Pair:
        p = parameters
        return ridden(p.own_limits, state[USER_ROW], state[USER_ROW + 1], action, p.adversary_speed, p.time_step)

    @template
    def settle(parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray) -> None:
        next_state[USER_ROW], next_state[USER_ROW + 1] = settled(state[USER_ROW], vx, vy)

    @template
    def possible(parameters: Any, state: FloatArray, vx: float, vy: float) -> Pair:
        p = parameters
        return nearest_ridden(
            p.own_limits, state[USER_ROW], state[USER_ROW + 1], vx, vy, p.adversary_speed, p.time_step
        )

    @template
    def moving(parameters: Any, state: FloatArray) -> Pair:
        return state[USER_ROW + 1] * math.cos(state[USER_ROW]), state[USER_ROW + 1] * math.sin(state[USER_ROW])

    @kernel(inline=True)
    def next_velocity(parameters: Any, vx: float, vy: float, action: int) -> Pair:
        p = parameters
        heading, speed = settled(p.own_heading, vx, vy)
        return ridden(p.own_limits, heading, speed, action, p.adversary_speed, p.time_step)

    @kernel(inline=True)
    def next_possible(parameters: Any, vx: float, vy: float, x: float, y: float) -> Pair:
        p = parameters
        heading, speed = settled(p.own_heading, vx, vy)
        return nearest_ridden(p.own_limits, heading, speed, x, y, p.adversary_speed, p.time_step)

    @template
    def pointing(parameters: Any, state: FloatArray, vx: float, vy: float) -> float:
        return settled(state[USER_ROW], vx, vy)[0]

    @template
    def steer(parameters: Any, state: FloatArray, direction: int) -> int:
        return steered(parameters.own_limits, parameters.crossing, state[USER_ROW], direction)

    @kernel(inline=True)
    def touch(parameters: Any, before: Pair, after: Pair, turned: float) -> float:
        p = parameters
        own = (p.own_half_length, p.own_half_width)
        return first_contact_of_boxes(before, after, turned, (p.front, p.rear, p.half_width), own)


def wheeled(name: str, limits: RidingLimits, **about: Any) -> RoadUserModel:
    """Return a kind of road user on wheels, by its limits; further arguments as of `walker`."""

    def parameters(scenario: Scenario) -> Mapping[str, Any]:
        """Return limits, half of the box's length and of its width (m), and how it comes without φ."""
        adversary = scenario.adversary
        _, half_length, half_width = adversary.shape
        return {
            "own_limits": limits,
            "own_half_length": half_length,
            "own_half_width": half_width,
            "own_heading": adversary.first_heading,
            "own_speed": adversary.speed if adversary.start_speed is None else adversary.start_speed,
        }

    return RoadUserModel(name, _Wheeled, parameters, **about)


# --- the kinds that there are: those on foot weigh as the dummies Hybrid III of a man and of a child of six, and a man
# rides the others. The fastest runner has reached 12.4 m/s (U. Bolt, 2009). Limits: docs/decisions.md (4).

_ON_FOOT: Final = ("pedestrian", "TYPE_PEDESTRIAN", "pedestrian", "pedestrian")
PEDESTRIAN: Final = RoadUserModel(
    "pedestrian", _Pedestrian, lambda scenario: {}, fastest=12.0, height=1.8, mass=78.0,
    names=_named("walker.pedestrian.0001", "PEDESTRIAN", *_ON_FOOT),
)  # fmt: skip
RUNNER: Final = walker(
    "runner", 3.0, fastest=12.0, height=1.8, mass=78.0, names=_named("walker.pedestrian.0001", "", *_ON_FOOT)
)
CHILD: Final = walker(
    "child", 2.0, fastest=8.0, height=1.2, mass=23.0, names=_named("walker.pedestrian.0011", "", *_ON_FOOT)
)
CYCLIST: Final = wheeled(
    "cyclist", RidingLimits(1.0, 3.0, 3.0), fastest=20.0, height=1.8, mass=95.0,
    names=_named("vehicle.diamondback.century", "CYCLIST", "bicycle", "TYPE_BICYCLE", "bicycle", "bicycle"),
)  # fmt: skip
E_SCOOTER: Final = wheeled(
    "e_scooter", RidingLimits(1.2, 3.5, 2.5), fastest=15.0, height=1.9, mass=95.0,
    names=_named("", "", "bicycle", "TYPE_STANDUP_SCOOTER", "bicycle", ""),
)  # fmt: skip
MOTORCYCLE: Final = wheeled(
    "motorcycle", RidingLimits(4.0, 5.5, 4.0, radius=2.5), fastest=85.0, height=1.5, mass=280.0,
    names=_named("vehicle.kawasaki.ninja", "CYCLIST", "motorbike", "TYPE_MOTORBIKE", "motorcycle", "motorcycle"),
)  # fmt: skip
CAR: Final = wheeled(
    "car", RidingLimits(2.5, 6.0, 4.0, radius=5.5), fastest=70.0, height=1.5, mass=1500.0,
    names=_named("vehicle.tesla.model3", "VEHICLE", "car", "TYPE_MEDIUM_CAR", "car", "car"),
)  # fmt: skip
VAN: Final = wheeled(
    "van", RidingLimits(2.0, 5.0, 3.5, radius=6.5), fastest=50.0, height=2.4, mass=2500.0,
    names=_named("vehicle.mercedes.sprinter", "", "van", "TYPE_DELIVERY_VAN", "", "van"),
)  # fmt: skip


def road_user_named(kind: str) -> RoadUserModel:
    """Return the road user of a kind.

    Raises:
        UsageError: there is none, or it is none.
    """
    try:
        found = ROAD_USERS.find(kind)
    except UsageError as error:
        raise UsageError(f"adversary.kind: {error}") from None
    if not isinstance(found, RoadUserModel):
        raise UsageError(f"adversary.kind: road user {kind!r} must be a RoadUserModel, got {type(found).__name__}")
    return found


def check_kind(scenario: Scenario) -> None:
    """Refuse an adversary that is faster than its kind, or has not the shape that it moves with.

    Raises:
        UsageError: it is so, or there is no such kind.
    """
    adversary, where = scenario.adversary, f"scenario {scenario.name}"
    user = road_user_named(adversary.kind)
    if adversary.speed > user.fastest:
        what = f"adversary.speed {adversary.speed:g} m/s is more than any {user.name} does"
        raise UsageError(f"{where}: {what}; give at most {user.fastest:g}")
    if user.kernels.box and not adversary.is_box:
        raise UsageError(f"{where}: a {user.name} is a box that points the way it moves; give length and width")
