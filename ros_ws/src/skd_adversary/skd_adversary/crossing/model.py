"""The adversary's POMDP, put together: objective × prediction of the car × sensor × road user, on a road.

State (paper, "Generating Kamikaze Trajectories"): road user × predicted car × parameters of the car's policy, behind
them what a kind of car, a kind of road user and the objective have of their own. The car's place is its path coordinate
s along the road's centre line (`skd_sim.scenario.road`): y on the straight lane.
"""

from __future__ import annotations

import functools
import math
from collections import namedtuple
from collections.abc import Mapping
from typing import Any

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.ending import inside
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import runs_into

from skd_adversary.crossing.on_foot import PEDESTRIAN
from skd_adversary.crossing.parts import (
    CarKernels,
    CarPrediction,
    ObjectiveModel,
    RoadKernels,
    RoadUserKernels,
    RoadUserModel,
    SensorModel,
    advance_car,
    begin,
    bound,
    contact,
    place_car,
    pointing,
    redraw_policy,
    resume_car,
    settle,
    start_car,
    start_road_user,
    template,
)
from skd_adversary.crossing.roads import CURVED, STRAIGHT
from skd_adversary.pomdp.model import Pomdp

# State vector; the trigger is the distance within which the car brakes, m (s for some learned cars)
ADVERSARY_X, ADVERSARY_Y, CAR_S, CAR_SPEED, TRIGGER = range(5)
STATE_DIM = 5


within = kernel(inline=True)(inside)
"""As `skd_sim.scenario.scenario.inside`, for kernels."""


@kernel(inline=True)
def leads_nowhere(
    parameters: Any, across: float, along: float, x: float, y: float, x_after: float, y_after: float
) -> bool:
    """Return whether a step ends where the car cannot be met any more, or leads into something that stands.

    Args:
        parameters: parameters of the model.
        across: offset to the right of the road's centre line at the end of the step, m.
        along: path coordinate at the end of the step, m.
        x: place to the East at the beginning of the step, m.
        y: place to the North at the beginning of the step, m.
        x_after: place to the East at the end of the step, m.
        y_after: place to the North at the end of the step, m.
    """
    p = parameters
    if within(p.loss, across, along):
        return True
    # On an open road the call alone would take as long as the rest of a step.
    return p.obstacles.shape[0] > 0 and runs_into(p.obstacles, x, y, x_after, y_after, p.core)


@template("start_road_user", "start_car", "begin", inline=False)
def initial_state(parameters: Any, state: FloatArray, rng: np.random.Generator) -> None:
    """Draw a state from the initial belief: the adversary's own state is known, start and policy of the car are not."""
    state[ADVERSARY_X] = parameters.start_x
    state[ADVERSARY_Y] = parameters.start_y
    start_road_user(parameters, state)
    start_car(parameters, state, rng)
    begin(parameters, state)


@template("advance_car", "settle", "pointing", "contact")
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
    return contact(p, x, y, x_after, y_after, pointing(p, state, vx, vy), state[CAR_S], next_state[CAR_S])


@template("resume_car", "place_car", "redraw_policy", inline=False)
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
    scenario: Scenario,
    *,
    start: tuple[float, float],
    gap: float,
    path: FloatArray,
    maximum_distance: float | None = None,
) -> Mapping[str, Any]:
    """Return the parameters that every model has, by name; lengths in m, speeds in m/s, times in s.

    Args:
        scenario: fixed description of the test.
        start: place (x, y) where the adversary starts, m.
        gap: distance from the front bumper to the crossing line before the episode's draw, m.
        path: φ, n × 2, m; a single row where there is no φ.
        maximum_distance: greatest distance from φ, m; by default there is no limit.
    """
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
        "crossing": scenario.end.crossing,
        "arrival": scenario.end.arrival,
        "loss": scenario.end.loss,
        "car_start_low": nearest - car.start_gap_range,  # s of the car's reference point
        "car_start_high": nearest,
        "car_start_speed": car.start_speed,
        "deceleration": car.deceleration,
        "maximum_distance": math.inf if maximum_distance is None else maximum_distance,
        "obstacles": np.array(scenario.rectangles),  # a copy, as of φ
        "core": adversary.core,
        "path": np.array(path, dtype=np.float64, order="C"),  # a copy: one type for kernels, read-only or not
    }


_CLASS, _SEPARATOR = "Parameters", "__"
_CAR_INTERFACES = ("start_car", "advance_car", "expected_acceleration", "resume_car", "redraw_policy", "last_changes")
_ROAD_INTERFACES = ("on_road", "velocity_on_road", "from_car", "left_behind", "at_distance")
_USER_INTERFACES = (
    "start_road_user",
    "velocity",
    "settle",
    "possible",
    "moving",
    "next_velocity",
    "next_possible",
    "pointing",
    "steer",
    "touch",
)
_SENSOR_INTERFACES = ("observe", "likelihood", "place_car")


def _road_of(scenario: Scenario) -> RoadKernels:
    return STRAIGHT if scenario.road.straight else CURVED


@functools.cache
def _interfaces(part: CarKernels | SensorModel, names: tuple[str, ...], road: RoadKernels) -> dict[str, Any]:
    """Return what a kind of car or a sensor brings into models on a road, by interface."""
    name, parts = f"{part.name}_{road.name}", _road_interfaces(road)
    return {interface: bound(getattr(part, interface), name, parts) for interface in names}


def _road_interfaces(road: RoadKernels) -> dict[str, Any]:
    return {interface: getattr(road, interface) for interface in _ROAD_INTERFACES}


@functools.cache
def road_user_interfaces(road_user: RoadUserKernels, car: CarKernels) -> dict[str, Any]:
    """Return what a road user brings into models with a kind of car, by interface."""
    name = f"{road_user.name}_{car.name}"
    parts = {
        "USER_ROW": STATE_DIM + car.own_dim,
        "USER_DIM": road_user.own_dim,
        "REST": road_user.rest,
        "LATE_ACTIONS": road_user.late,
        "EARLY_ACTIONS": road_user.early,
    }
    return {**parts, **{interface: bound(getattr(road_user, interface), name, parts) for interface in _USER_INTERFACES}}


@functools.cache
def transition_parts(car: CarKernels, road_user: RoadUserKernels, road: RoadKernels) -> dict[str, Any]:
    """Return what objectives can use of a kind of car, a road user and a road, `move` included, by interface."""
    name = f"{road_user.name}_{car.name}_{road.name}"
    parts = {
        **_road_interfaces(road),
        **_interfaces(car, _CAR_INTERFACES, road),
        **road_user_interfaces(road_user, car),
        "AS_PHI": road_user.action_count,
    }
    parts["contact"] = bound(road.contact, name, parts)
    parts["move"] = bound(move, name, parts)
    return parts


@functools.cache
def _kernels(
    objective: ObjectiveModel, car: CarKernels, road_user: RoadUserKernels, road: RoadKernels
) -> dict[str, Any]:
    """Return the functions of a `Pomdp` that depend on the objective, by name."""
    name = f"{objective.name}_{road_user.name}_{car.name}_{road.name}"
    parts = dict(transition_parts(car, road_user, road))
    parts["ROW"] = parts["USER_ROW"] + road_user.own_dim
    parts["begin"] = bound(objective.begin, name, parts)
    parts["chosen"] = bound(objective.chosen, name, parts) or parts["velocity"]
    parts["sensible"] = bound(objective.sensible, name, parts)
    functions = {
        "initial": initial_state,
        "step": objective.step,
        "rollout_action": objective.rollout_action,
        "legal": objective.legal,
    }
    return {function: bound(one, name, parts) for function, one in functions.items()}


@functools.cache
def _reinvigorate(car: CarKernels, sensor: SensorModel, road: RoadKernels) -> Any:
    parts = {**_interfaces(car, _CAR_INTERFACES, road), **_interfaces(sensor, _SENSOR_INTERFACES, road)}
    return bound(reinvigorate, f"{car.name}_{sensor.name}_{road.name}", parts)


@functools.cache
def _parameters_class(*names: str) -> Any:
    """Return the one class of named tuples with these fields, which are known at run time only.

    Compiled code that is kept on disk refers to it by its name, which holds the fields for that: see `__getattr__`.
    """
    made: Any = namedtuple(_SEPARATOR.join((_CLASS, *names)), names)  # type: ignore[misc]
    return made


def __getattr__(name: str) -> Any:
    """Return the class of parameters of this name."""
    kind, *fields = name.split(_SEPARATOR)
    if kind != _CLASS or not fields:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    return _parameters_class(*fields)


def compose(
    scenario: Scenario,
    objective: ObjectiveModel,
    car: CarPrediction,
    *,
    start: tuple[float, float],
    gap: float,
    path: FloatArray | None = None,
    maximum_distance: float | None = None,
    road_user: RoadUserModel = PEDESTRIAN,
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

    Raises:
        ValueError: two parts have a parameter of the same name.
    """
    phi = np.array([start]) if path is None else path
    sensor, road, user = car.sensor, _road_of(scenario), road_user.kernels
    shares = (
        crossing_parameters(scenario, start=start, gap=gap, path=phi, maximum_distance=maximum_distance),
        road.parameters(scenario),
        road_user.parameters(scenario),
        car.parameters(scenario),
        sensor.parameters(scenario),
        objective.parameters(scenario, phi),
    )
    values: dict[str, Any] = {}
    for share in shares:
        if twice := values.keys() & share.keys():
            raise ValueError(f"{objective.name}: two parts of the model have a parameter {min(twice)}")
        values |= share
    seen = _interfaces(sensor, _SENSOR_INTERFACES, road)
    return Pomdp(
        name=f"{objective.name}_{user.name}_{car.kernels.name}_{sensor.name}_{road.name}",
        state_dim=STATE_DIM + car.kernels.own_dim + user.own_dim + objective.own_dim(len(phi)),
        observation_dim=1,
        action_count=user.action_count + objective.follows_phi,
        discount=objective.discount,
        parameters=_parameters_class(*values)(**values),
        observe=seen["observe"],
        likelihood=seen["likelihood"],
        reinvigorate=_reinvigorate(car.kernels, sensor, road),
        **_kernels(objective, car.kernels, user, road),
    )
