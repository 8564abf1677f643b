"""Puts a model together: objective × prediction of the car × sensor × road user, on a road."""

from __future__ import annotations

import functools
from collections import namedtuple
from typing import Any, NamedTuple

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.scenario.scenario import Scenario

from skd_adversary.crossing import crossing
from skd_adversary.crossing.parts import (
    CarKernels,
    CarPrediction,
    ObjectiveModel,
    RoadKernels,
    RoadUserKernels,
    RoadUserModel,
    Sensor,
    bound,
)
from skd_adversary.crossing.road import curved, straight
from skd_adversary.crossing.road_user import pedestrian
from skd_adversary.pomdp.model import Pomdp


class _Kernels(NamedTuple):
    initial: Any
    step: Any
    rollout_action: Any
    legal: Any


_CLASS, _SEPARATOR = "Parameters", "__"
_CAR_INTERFACES = ("start_car", "advance_car", "foreseen_acceleration", "resume_car", "redraw_policy", "last_changes")
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
    return straight.ROAD if scenario.road.straight else curved.ROAD


@functools.cache
def _road_interfaces(road: RoadKernels) -> dict[str, Any]:
    return {interface: getattr(road, interface) for interface in _ROAD_INTERFACES}


@functools.cache
def _car_interfaces(car: CarKernels, road: RoadKernels) -> dict[str, Any]:
    parts, name = _road_interfaces(road), f"{car.name}_{road.name}"
    return {interface: bound(getattr(car, interface), name, parts) for interface in _CAR_INTERFACES}


@functools.cache
def road_user_interfaces(road_user: RoadUserKernels, car: CarKernels) -> dict[str, Any]:
    """Return what a road user brings into models with a kind of car, by interface."""
    name = f"{road_user.name}_{car.name}"
    parts = {
        "USER_ROW": crossing.STATE_DIM + car.own_dim,
        "USER_DIM": road_user.own_dim,
        "REST": road_user.rest,
        "LATE_ACTIONS": road_user.late,
        "EARLY_ACTIONS": road_user.early,
    }
    return {**parts, **{interface: bound(getattr(road_user, interface), name, parts) for interface in _USER_INTERFACES}}


@functools.cache
def _sensor_interfaces(sensor: Sensor, road: RoadKernels) -> dict[str, Any]:
    parts, name = _road_interfaces(road), f"{sensor.name}_{road.name}"
    return {interface: bound(getattr(sensor, interface), name, parts) for interface in _SENSOR_INTERFACES}


@functools.cache
def transition_parts(car: CarKernels, road_user: RoadUserKernels, road: RoadKernels) -> dict[str, Any]:
    """Return what objectives can use of a kind of car, a road user and a road, `move` included, by interface."""
    name = f"{road_user.name}_{car.name}_{road.name}"
    parts = {**_road_interfaces(road), **_car_interfaces(car, road), **road_user_interfaces(road_user, car)}
    parts["AS_PHI"] = road_user.action_count
    parts["contact"] = bound(road.contact, name, parts)
    parts["move"] = bound(crossing.move, name, parts)
    return parts


@functools.cache
def _all_parts(
    objective: ObjectiveModel, car: CarKernels, road_user: RoadUserKernels, road: RoadKernels
) -> tuple[str, dict[str, Any]]:
    name = f"{objective.name}_{road_user.name}_{car.name}_{road.name}"
    parts = dict(transition_parts(car, road_user, road))
    parts["ROW"] = parts["USER_ROW"] + road_user.own_dim
    parts["begin"] = bound(objective.begin, name, parts)
    parts["chosen"] = bound(objective.chosen, name, parts) or parts["velocity"]
    parts["sensible"] = bound(objective.sensible, name, parts)
    return name, parts


@functools.cache
def _kernels(objective: ObjectiveModel, car: CarKernels, road_user: RoadUserKernels, road: RoadKernels) -> _Kernels:
    name, parts = _all_parts(objective, car, road_user, road)
    return _Kernels(
        initial=bound(crossing.initial_state, name, parts),
        step=bound(objective.step, name, parts),
        rollout_action=bound(objective.rollout_action, name, parts),
        legal=bound(objective.legal, name, parts),
    )


@functools.cache
def _reinvigorate(car: CarKernels, sensor: Sensor, road: RoadKernels) -> Any:
    parts = {**_car_interfaces(car, road), **_sensor_interfaces(sensor, road)}
    return bound(crossing.reinvigorate, f"{car.name}_{sensor.name}_{road.name}", parts)


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
    road_user: RoadUserModel = pedestrian.ROAD_USER,
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
        crossing.crossing_parameters(scenario, start=start, gap=gap, path=phi, maximum_distance=maximum_distance),
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
    kernels = _kernels(objective, car.kernels, user, road)
    seen = _sensor_interfaces(sensor, road)
    return Pomdp(
        name=f"{objective.name}_{user.name}_{car.kernels.name}_{sensor.name}_{road.name}",
        state_dim=crossing.STATE_DIM + car.kernels.own_dim + user.own_dim + objective.own_dim(len(phi)),
        observation_dim=1,
        action_count=user.action_count + objective.follows_phi,
        discount=objective.discount,
        parameters=_parameters_class(*values)(**values),
        initial=kernels.initial,
        step=kernels.step,
        observe=seen["observe"],
        likelihood=seen["likelihood"],
        rollout_action=kernels.rollout_action,
        reinvigorate=_reinvigorate(car.kernels, sensor, road),
        legal=kernels.legal,
    )
