"""The adversary's POMDP, composed: objective × prediction of the car × sensor × road user, on a road.

`interfaces` says what a state is and what each part brings; `compose` compiles their templates with one another, and
puts their parameters together.
"""

from __future__ import annotations

import functools
import math
from collections import namedtuple
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from skd_sim.kernels.compilation import bound, kernel
from skd_sim.scenario.ending import Ending
from skd_sim.scenario.road import HEADING_NORTH, road_pose, road_position, straight_from
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import to_car_frame
from skd_sim.world.state import FloatArray, IntArray, Pair

from skd_adversary.crossing.interfaces import (
    ADVERSARY_X,
    ADVERSARY_Y,
    AS_PHI,
    CAR_S,
    STATE_DIM,
    CarKernels,
    CarPrediction,
    ObjectiveModel,
    RoadKernels,
    RoadUserKernels,
    RoadUserModel,
    SensorModel,
    advance_car,
    aside,
    begin,
    contact,
    kernels_of,
    path_velocities,
    place_car,
    pointing,
    possible,
    redraw_policy,
    resume_car,
    settle,
    start_car,
    start_road_user,
    template,
    to_middle,
    touch,
    velocity,
)
from skd_adversary.crossing.kamikaze import DEVIATION
from skd_adversary.crossing.objectives import FRECHET, PAPER, SAFE
from skd_adversary.crossing.road_users import PEDESTRIAN
from skd_adversary.pomdp.model import Pomdp

# --- the road that the predicted car follows: the straight lane x = 0, driven to the North, or one with curves. On the
# straight lane path coordinates are the world's own. On a curved road the car's place is a path coordinate, and what is
# near it is seen from the car's own frame.

_GRAZE: Final = 1e-9  # m


@kernel(inline=True)
def _from_aside(ahead: float, left: float, aside: Pair) -> Pair:
    """Return how far ahead and to the left (m) of a car aside of the centre line a point is, from those of the line."""
    offset, turned = aside
    cos, sin = math.cos(turned), math.sin(turned)
    return cos * ahead - sin * (left + offset), sin * ahead + cos * (left + offset)


class _Straight(RoadKernels):
    """A straight road to the North."""

    name = "straight"

    @staticmethod
    def parameters(scenario: Scenario) -> Mapping[str, Any]:
        return {}

    @kernel(inline=True)
    def on_road(parameters: Any, x: float, y: float) -> Pair:
        return x, y

    @kernel(inline=True)
    def velocity_on_road(parameters: Any, x: float, y: float, vx: float, vy: float) -> Pair:
        return vx, vy

    @kernel(inline=True)
    def from_car(parameters: Any, x: float, y: float, car_s: float) -> Pair:
        return y - car_s, -x

    @kernel(inline=True)
    def to_middle(parameters: Any, x: float, y: float, car_s: float, aside: Pair) -> Pair:
        if aside[0] == 0.0 and aside[1] == 0.0:
            return x, y
        ahead, left = _from_aside(y - car_s, -x, aside)
        return -left, car_s + ahead

    @kernel(inline=True)
    def left_behind(parameters: Any, x: float, y: float, car_s: float) -> bool:
        return bool(car_s - parameters.rear > y + parameters.radius)

    @kernel(inline=True)
    def at_distance(parameters: Any, x: float, y: float, distance: float, behind: bool) -> float:
        along = math.sqrt(max(0.0, distance * distance - x * x))
        return y - along if behind else y + along

    @template
    def contact(
        parameters: Any, place: Pair, place_after: Pair, heading: float, car_s: float, car_s_after: float
    ) -> float:
        """Interface `contact`: both in the world's own frame."""
        p = parameters
        x, y = place
        x_after, y_after = place_after
        # Far away, which is most of the time, the swept test need not be made. Who would only graze the car's side is
        # away, too: there the world's rounding decides, of a car that does not drive along x = 0 to the last bit.
        margin = p.radius + p.half_width - _GRAZE
        if (x < -margin and x_after < -margin) or (x > margin and x_after > margin):
            return math.inf
        if y - car_s > p.front + p.radius and y_after - car_s_after > p.front + p.radius:
            return math.inf
        return touch(p, (y - car_s, -x), (y_after - car_s_after, -x_after), heading - HEADING_NORTH)


STRAIGHT = _Straight


_SAGITTA: Final = 1e-3  # m, between a chord and its arc: a thousandth of what the sensors see
_HALVINGS = 30


@kernel(inline=True)
def _curved_from_car(parameters: Any, x: float, y: float, car_s: float) -> Pair:
    car_x, car_y, heading = road_pose(parameters.line, car_s)
    return to_car_frame(x, y, car_x, car_y, heading)


class _Curved(RoadKernels):
    """A road along a line with curves."""

    name = "curved"

    @staticmethod
    def parameters(scenario: Scenario) -> Mapping[str, Any]:
        """Return the line, where its straight rest begins, m, and a length of chords (m) for the sharpest curve."""
        line = scenario.road.line
        sharpest = float(abs(line[:, 4]).max())
        return {
            "line": line.copy(),
            "straight_from": straight_from(line),
            "chord": math.sqrt(8.0 * _SAGITTA / sharpest),
        }

    @kernel(inline=True)
    def on_road(parameters: Any, x: float, y: float) -> Pair:
        along, left = road_position(parameters.line, x, y)
        return -left, along

    @kernel(inline=True)
    def velocity_on_road(parameters: Any, x: float, y: float, vx: float, vy: float) -> Pair:
        along, _ = road_position(parameters.line, x, y)
        _, _, heading = road_pose(parameters.line, along)
        cos, sin = math.cos(heading), math.sin(heading)
        return sin * vx - cos * vy, cos * vx + sin * vy

    @kernel(inline=True)
    def to_middle(parameters: Any, x: float, y: float, car_s: float, aside: Pair) -> Pair:
        if aside[0] == 0.0 and aside[1] == 0.0:
            return x, y
        car_x, car_y, heading = road_pose(parameters.line, car_s)
        cos, sin = math.cos(heading), math.sin(heading)
        ahead, left = to_car_frame(x, y, car_x, car_y, heading)
        ahead, left = _from_aside(ahead, left, aside)
        return car_x + cos * ahead - sin * left, car_y + sin * ahead + cos * left

    @kernel(inline=True)
    def left_behind(parameters: Any, x: float, y: float, car_s: float) -> bool:
        """Interface `left_behind`: beyond the last curve, and seen from the car."""
        p = parameters
        if car_s < p.straight_from:
            return False
        ahead, _ = _curved_from_car(p, x, y, car_s)
        return bool(ahead < -(p.rear + p.radius))

    @kernel(inline=True)
    def at_distance(parameters: Any, x: float, y: float, distance: float, behind: bool) -> float:
        """Interface `at_distance`: by bisection; an arc is at most π/2 times as long as its chord, to half a turn."""
        near, _ = road_position(parameters.line, x, y)
        far = near - 2.0 * distance if behind else near + 2.0 * distance
        for _ in range(_HALVINGS):
            middle = 0.5 * (near + far)
            ahead, left = _curved_from_car(parameters, x, y, middle)
            if ahead * ahead + left * left < distance * distance:
                near = middle
            else:
                far = middle
        return near

    @template
    def contact(
        parameters: Any, place: Pair, place_after: Pair, heading: float, car_s: float, car_s_after: float
    ) -> float:
        """Interface `contact`: piece by piece, each a chord of the car's path."""
        p = parameters
        x, y = place
        x_after, y_after = place_after
        ahead, left = _curved_from_car(p, x, y, car_s)
        travelled = car_s_after - car_s
        reach = math.hypot(max(p.front, p.rear), p.half_width) + p.radius
        if math.hypot(ahead, left) > reach + travelled + math.hypot(x_after - x, y_after - y):
            return math.inf
        pieces = max(1, math.ceil(travelled / p.chord))
        for piece in range(pieces):
            share = (piece + 1) / pieces
            car_here = car_s + share * travelled
            x_here, y_here = x + share * (x_after - x), y + share * (y_after - y)
            ahead_here, left_here = _curved_from_car(p, x_here, y_here, car_here)
            _, _, car_heading = road_pose(p.line, car_here)
            fraction = touch(p, (ahead, left), (ahead_here, left_here), heading - car_heading)
            if fraction <= 1.0:
                return float((piece + fraction) / pieces)
            ahead, left = ahead_here, left_here
        return math.inf

    from_car = _curved_from_car


CURVED = _Curved


# --- the parts together


@template(inline=False)
def initial_state(parameters: Any, state: FloatArray, rng: np.random.Generator) -> None:
    """Draw a state from the initial belief: the adversary's own state is known, start and policy of the car are not."""
    state[ADVERSARY_X] = parameters.start_x
    state[ADVERSARY_Y] = parameters.start_y
    start_road_user(parameters, state)
    start_car(parameters, state, rng)
    begin(parameters, state)


@template
def move(
    parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray, rng: np.random.Generator
) -> float:
    """Interface `move`: both move uniformly within the step."""
    p = parameters
    x, y = state[ADVERSARY_X], state[ADVERSARY_Y]
    x_after, y_after = x + p.time_step * vx, y + p.time_step * vy
    advance_car(p, state, vx, vy, next_state, rng)
    next_state[ADVERSARY_X] = x_after
    next_state[ADVERSARY_Y] = y_after
    settle(p, state, vx, vy, next_state)
    heading = pointing(p, state, vx, vy)
    place = to_middle(p, x, y, state[CAR_S], aside(p, state))
    place_after = to_middle(p, x_after, y_after, next_state[CAR_S], aside(p, next_state))
    return contact(p, place, place_after, heading, state[CAR_S], next_state[CAR_S])


@template(inline=False)
def reinvigorate(
    parameters: Any, state: FloatArray, observation: FloatArray, redrawn: FloatArray, rng: np.random.Generator
) -> None:
    """Keep the adversary's own state and all else that is known for sure; draw the car anew where it was observed."""
    redrawn[STATE_DIM:] = state[STATE_DIM:]
    redrawn[ADVERSARY_X] = state[ADVERSARY_X]
    redrawn[ADVERSARY_Y] = state[ADVERSARY_Y]
    resume_car(parameters, state, redrawn, rng)
    place_car(parameters, state, observation, redrawn, rng)
    redraw_policy(parameters, redrawn, rng)


def crossing_parameters(
    scenario: Scenario, end: Ending, start: Pair, gap: float, path: FloatArray, maximum_distance: float | None
) -> Mapping[str, Any]:
    """Return the parameters that every model has, by name; arguments as of `compose`, φ n × 2 with n ≥ 1."""
    car, adversary = scenario.car, scenario.adversary
    nearest = -gap - car.front
    return {
        "time_step": scenario.time_step,
        "front": car.front,
        "rear": car.rear,
        "half_width": car.half_width,
        "radius": adversary.reach,
        "adversary_speed": adversary.speed,
        "start_x": float(start[0]),
        "start_y": float(start[1]),
        "crossing": end.crossing,
        "arrival": end.arrival,
        "loss": end.loss,
        "car_start_low": nearest - car.start_gap_range,  # s of the car's reference point
        "car_start_high": nearest,
        "car_start_speed": car.start_speed,
        "deceleration": car.deceleration,
        "maximum_distance": math.inf if maximum_distance is None else maximum_distance,
        "obstacles": np.array(scenario.rectangles),  # a copy, as of φ
        "core": adversary.core,
        "distance_noise": adversary.distance_noise,
        "position_noise": adversary.position_noise,
        "path": np.array(path, dtype=np.float64, order="C"),  # a copy: one type for kernels, read-only or not
    }


@functools.cache
def road_user_parts(road_user: type[RoadUserKernels], car: type[CarKernels]) -> dict[str, Any]:
    """Return what a road user brings into models with a kind of car, by interface."""
    parts = {
        "USER_ROW": STATE_DIM + car.own_dim,
        "USER_DIM": road_user.own_dim,
        "REST": road_user.rest,
        "LATE_ACTIONS": road_user.late,
        "EARLY_ACTIONS": road_user.early,
    }
    return parts | kernels_of(road_user, f"{road_user.name}_{car.name}", parts)


@functools.cache
def _part_on_road(part: type[CarKernels] | type[SensorModel], road: type[RoadKernels]) -> dict[str, Any]:
    """Return what a kind of car or a sensor brings into models on a road, by interface."""
    return kernels_of(part, f"{part.name}_{road.name}", kernels_of(road, road.name, {}))


@functools.cache
def transition_parts(
    car: type[CarKernels], road_user: type[RoadUserKernels], road: type[RoadKernels]
) -> dict[str, Any]:
    """Return what objectives can use of a kind of car, a road user and a road, `move` included, by interface."""
    name = f"{road_user.name}_{car.name}_{road.name}"
    parts = _part_on_road(car, road) | road_user_parts(road_user, car) | {"AS_PHI": road_user.action_count}
    parts |= kernels_of(road, name, parts)
    return parts | {"move": bound(move, name, parts)}


@functools.cache
def _kernels(
    objective: ObjectiveModel, car: type[CarKernels], road_user: type[RoadUserKernels], road: type[RoadKernels]
) -> dict[str, Any]:
    """Return the functions of a `Pomdp` that depend on the objective, by name."""
    name = f"{objective.name}_{road_user.name}_{car.name}_{road.name}"
    parts = dict(transition_parts(car, road_user, road))
    parts["ROW"] = parts["USER_ROW"] + road_user.own_dim
    parts["begin"] = bound(objective.begin, name, parts)
    return {
        "initial": bound(initial_state, name, parts),
        "step": bound(objective.step, name, parts),
        "rollout_action": bound(objective.rollout_action, name, parts),
        "legal": bound(objective.legal, name, parts),
    }


@functools.cache
def _reinvigorate(car: type[CarKernels], sensor: type[SensorModel], road: type[RoadKernels]) -> Any:
    parts = _part_on_road(car, road) | _part_on_road(sensor, road)
    return bound(reinvigorate, f"{car.name}_{sensor.name}_{road.name}", parts)


_CLASS, _SEPARATOR = "Parameters", "__"


@functools.cache
def _parameters_class(*names: str) -> Any:
    """Return the one class of named tuples with these fields, which are known at run time only.

    Compiled code that is kept on disk refers to it by its name, which holds the fields for that: see `__getattr__`.
    """
    made: Any = namedtuple(_SEPARATOR.join((_CLASS, *names)), names)  # type: ignore[misc]
    return made


def __getattr__(name: str) -> Any:
    """Return the class of parameters of this name."""
    kind, *names = name.split(_SEPARATOR)
    if kind != _CLASS or not names:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    return _parameters_class(*names)


def compose(
    scenario: Scenario,
    objective: ObjectiveModel,
    car: CarPrediction,
    *,
    start: Pair,
    gap: float,
    path: FloatArray | None = None,
    maximum_distance: float | None = None,
    road_user: RoadUserModel = PEDESTRIAN,
    end: Ending | None = None,
) -> Pomdp:
    """Return the adversary's POMDP.

    Args:
        scenario: fixed description of the test.
        objective: what the adversary wants.
        car: prediction of the car, which brings the sensor with it.
        start: place (x, y) where the adversary starts, m: the first point of φ.
        gap: distance from the front bumper to the crossing line before the episode's draw, m.
        path: φ, n × 2, m, one point per tick; None for an objective that has no φ.
        maximum_distance: greatest distance from φ, m, for an objective that limits it; by default there is no limit.
        road_user: kind of road user, which says how the adversary can move.
        end: when an episode is over; by default as the scenario says.

    Raises:
        ValueError: two parts have a parameter of the same name.
    """
    phi = np.array([start]) if path is None else path
    sensor, road, user = car.sensor, STRAIGHT if scenario.road.straight else CURVED, road_user.kernels
    shares = (
        crossing_parameters(scenario, end or scenario.end, start, gap, phi, maximum_distance),
        road.parameters(scenario),
        road_user.parameters(scenario),
        car.parameters(scenario),
        objective.parameters(scenario, phi),
    )
    values: dict[str, Any] = {}
    for share in shares:
        if twice := values.keys() & share.keys():
            raise ValueError(f"{objective.name}: two parts of the model have a parameter {min(twice)}")
        values |= share
    all_values: dict[str, Any] = {}
    for one in (SAFE, PAPER, FRECHET, DEVIATION):  # models that differ in these alone share a type, and so kernels
        all_values |= one.parameters(scenario, phi)
    values = dict(sorted((all_values | values).items()))
    seen = _part_on_road(sensor, road)
    return Pomdp(
        name=f"{objective.name}_{user.name}_{car.kernels.name}_{sensor.name}_{road.name}",
        state_dim=STATE_DIM + car.kernels.own_dim + user.own_dim + objective.own_dim(len(phi)),
        observation_dim=sensor.observation_dim,
        action_count=user.action_count + objective.follows_phi,
        discount=objective.discount,
        parameters=_parameters_class(*values)(**values),
        observe=seen["observe"],
        likelihood=seen["likelihood"],
        reinvigorate=_reinvigorate(car.kernels, sensor, road),
        **_kernels(objective, car.kernels, user, road),
    )


@template(inline=False)
def walk(parameters: Any, state: FloatArray, actions: IntArray, phi: FloatArray, positions: FloatArray) -> None:
    """Write where a road user goes that takes actions from the start on.

    Args:
        parameters: of the road user.
        state: is used up.
        actions: number of the action in each tick.
        phi: φ's own velocity in each tick, ticks × 2, m/s.
        positions: at each tick, (ticks + 1) × 2, m; the first is given.
    """
    start_road_user(parameters, state)
    for tick in range(actions.shape[0]):
        if actions[tick] == AS_PHI:
            vx, vy = possible(parameters, state, phi[tick, 0], phi[tick, 1])
        else:
            vx, vy = velocity(parameters, state, actions[tick])
        settle(parameters, state, vx, vy, state)
        positions[tick + 1, 0] = positions[tick, 0] + parameters.time_step * vx
        positions[tick + 1, 1] = positions[tick, 1] + parameters.time_step * vy


@template(inline=False)
def hold(
    parameters: Any, state: FloatArray, held: FloatArray, went: FloatArray, phi: FloatArray, found: FloatArray
) -> None:
    """Write the velocities of each action that is held, from each tick of a trajectory on.

    Args:
        parameters: of the road user.
        state: is used up.
        held: likewise, of the same length.
        went: velocity in each tick of the trajectory, ticks × 2, m/s.
        phi: φ's own velocity in each tick, at least as many as are looked at, × 2, m/s.
        found: velocities, ticks × (actions, as φ last) × how long it is held in ticks × 2, m/s.
    """
    start_road_user(parameters, state)
    for tick in range(found.shape[0]):
        for action in range(found.shape[1]):
            held[:] = state
            for later in range(found.shape[2]):
                if action == AS_PHI:
                    vx, vy = possible(parameters, held, phi[tick + later, 0], phi[tick + later, 1])
                else:
                    vx, vy = velocity(parameters, held, action)
                settle(parameters, held, vx, vy, held)
                found[tick, action, later, 0], found[tick, action, later, 1] = vx, vy
        settle(parameters, state, went[tick, 0], went[tick, 1], state)


@functools.cache
def _motion_kernels(road_user: type[RoadUserKernels]) -> tuple[Any, Any]:
    name, parts = f"{road_user.name}_motion", {"USER_ROW": 0, "AS_PHI": road_user.action_count}
    parts |= kernels_of(road_user, name, parts)
    return bound(walk, name, parts), bound(hold, name, parts)


def _motion_parameters(user: RoadUserModel, scenario: Scenario, path: FloatArray) -> Any:
    values = {
        "time_step": scenario.time_step,
        "adversary_speed": scenario.adversary.speed,
        "crossing": scenario.end.crossing,
        "path": np.array(path, dtype=np.float64, order="C"),
        **user.parameters(scenario),
    }
    return _parameters_class(*values)(**values)


def walked(user: RoadUserModel, scenario: Scenario, path: FloatArray, sequences: IntArray) -> FloatArray:
    """Return where sequences of actions lead, n × (ticks + 1) × 2, m.

    Args:
        user: kind of road user.
        scenario: says how fast it is, and the time step.
        path: φ, k × 2, m; may be one point.
        sequences: number of the action in each tick, n × ticks; `action_count` is as φ.
    """
    count, ticks = sequences.shape
    parameters, state = _motion_parameters(user, scenario, path), np.zeros(user.kernels.own_dim)
    phi = path_velocities(path, ticks, scenario.time_step)
    found = np.empty((count, ticks + 1, 2))
    found[:, 0] = path[0]
    for actions, positions in zip(sequences, found, strict=True):
        _motion_kernels(user.kernels)[0](parameters, state, actions, phi, positions)
    return found


def choices(
    user: RoadUserModel, scenario: Scenario, path: FloatArray, moved: FloatArray, longest: int = 1
) -> FloatArray:
    """Return the velocities that a road user can choose in each tick of a trajectory, having gone it so far.

    Args:
        user: its kind.
        scenario: says how fast it is, and the time step.
        path: φ, k × 2, m; may be one point.
        moved: the trajectory, n × 2, m.
        longest: ticks for which a choice is held.

    Returns:
        (n − 1) × (action_count + 1) × longest × 2, m/s; the last choice is that which comes nearest to φ's own.
    """
    went = np.diff(moved, axis=0) / scenario.time_step
    phi = path_velocities(path, len(went) + longest, scenario.time_step)
    found = np.empty((len(went), user.kernels.action_count + 1, longest, 2))
    state, held = np.zeros((2, user.kernels.own_dim))
    _motion_kernels(user.kernels)[1](_motion_parameters(user, scenario, path), state, held, went, phi, found)
    return found
