"""Puts a model together: objective × prediction of the car × sensor × road user."""

from __future__ import annotations

import functools
from collections import namedtuple
from typing import Any, NamedTuple

import numpy as np
from skd_sim.encounter.scenario import Scenario

from skd_adversary.model import crossing
from skd_adversary.model.parts import CarKernels, CarPrediction, ObjectiveModel, RoadUserModel, Sensor, bound
from skd_adversary.model.road_user import pedestrian
from skd_adversary.planning.pomdp import FloatArray, Pomdp

_CAR_SLOTS = ("start_car", "advance_car", "foreseen_acceleration", "resume_car", "redraw_policy")


class _Kernels(NamedTuple):
    initial: Any
    step: Any
    rollout_action: Any
    legal: Any


def _car_slots(car: CarKernels) -> dict[str, Any]:
    return {slot: getattr(car, slot) for slot in _CAR_SLOTS}


@functools.cache
def transition(car: CarKernels, road_user: RoadUserModel) -> Any:
    """Return slot `move` for a kind of car and a road user."""
    return bound(crossing.move, f"{road_user.name}_{car.name}", _car_slots(car))


@functools.cache
def _kernels(objective: ObjectiveModel, car: CarKernels, road_user: RoadUserModel) -> _Kernels:
    name = f"{objective.name}_{road_user.name}_{car.name}"
    parts = {
        **_car_slots(car),
        "velocity": road_user.velocity,
        "move": transition(car, road_user),
        "ROW": crossing.STATE_DIM + car.own_dim,
        "AS_PHI": road_user.action_count,
    }
    parts["begin"] = bound(objective.begin, name, parts)
    return _Kernels(
        initial=bound(crossing.initial_state, name, parts),
        step=bound(objective.step, name, parts),
        rollout_action=bound(objective.rollout_action, name, parts),
        legal=bound(objective.legal, name, parts),
    )


@functools.cache
def _reinvigorate(car: CarKernels, sensor: Sensor) -> Any:
    parts = {**_car_slots(car), "place_car": sensor.place_car}
    return bound(crossing.reinvigorate, f"{car.name}_{sensor.name}", parts)


@functools.cache
def _parameters_class(*names: str) -> Any:
    """Return the one class of named tuples with these fields: compiled code is kept by class."""
    return namedtuple("Parameters", names)  # its fields are known at run time only


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
        car: what it thinks of the car; the sensor goes with it.
        start: the road user's start (x, y), m: the first point of φ.
        gap: front bumper to the crossing line before the episode's draw, m.
        path: φ, n × 2, m, one point per tick; none for an objective without.
        maximum_distance: from φ, m, for an objective that has a use for it; none by default.
        road_user: how the adversary can move.

    Raises:
        ValueError: two parts have a parameter of the same name.
    """
    phi = np.array([start]) if path is None else path
    sensor = car.sensor
    shares = (
        crossing.crossing_parameters(scenario, start=start, gap=gap, path=phi, maximum_distance=maximum_distance),
        car.parameters(scenario),
        sensor.parameters(scenario),
        objective.parameters(scenario, phi),
    )
    values: dict[str, Any] = {}
    for share in shares:
        if twice := values.keys() & share.keys():
            raise ValueError(f"{objective.name}: two parts of the model have a parameter {min(twice)}")
        values |= share
    kernels = _kernels(objective, car.kernels, road_user)
    return Pomdp(
        name=f"{objective.name}_{road_user.name}_{car.kernels.name}_{sensor.name}",
        state_dim=crossing.STATE_DIM + car.kernels.own_dim + objective.own_dim(len(phi)),
        observation_dim=1,
        action_count=road_user.action_count + objective.follows_phi,
        discount=objective.discount,
        parameters=_parameters_class(*values)(**values),
        initial=kernels.initial,
        step=kernels.step,
        observe=sensor.observe,
        likelihood=sensor.likelihood,
        rollout_action=kernels.rollout_action,
        reinvigorate=_reinvigorate(car.kernels, sensor),
        legal=kernels.legal,
    )
