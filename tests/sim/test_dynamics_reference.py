"""The multi-body model against the authors' own implementation, commonroad-vehicle-models."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from skd_sim.arrays import FloatArray
from skd_sim.world.dynamics.multi_body import (
    BMW_320I,
    FRONT,
    HEIGHT,
    JOINTS,
    LATERAL_SPEED,
    PITCH,
    REAR,
    ROLL,
    SOURCE_TYRE,
    SPEED,
    STATES,
    STEERING,
    TYRE,
    VERTICAL_SPEED,
    WHEELS,
    YAW,
    YAW_RATE,
    Tyre,
    Vehicle,
    WheelInput,
    full_derivative,
)
from skd_sim.world.dynamics.multi_body_car import rest_state
from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb
from vehiclemodels.vehicle_parameters import setup_vehicle_parameters

NO_ANTILOCK = (2.0, 3.0)


def _parameters(number: int) -> tuple[Any, Vehicle, Tyre]:
    """Parameters of a CommonRoad vehicle, theirs and as ours."""
    theirs = setup_vehicle_parameters(number)
    flat = {**vars(theirs), "a_max": theirs.longitudinal.a_max, "v_switch": theirs.longitudinal.v_switch}
    vehicle = Vehicle(**{name: float(flat[name]) for name in Vehicle._fields})
    return theirs, vehicle, Tyre(**{name: float(getattr(theirs.tire, name)) for name in Tyre._fields})


def _torques(vehicle: Vehicle, acceleration: float, steering_rate: float) -> WheelInput:
    force = 0.5 * vehicle.m * vehicle.R_w
    brake, drive = max(0.0, -acceleration) * force, max(0.0, acceleration) * force
    return WheelInput(
        steering_rate,
        vehicle.T_sb * brake,
        (1.0 - vehicle.T_sb) * brake,
        vehicle.T_se * drive,
        (1.0 - vehicle.T_se) * drive,
        *NO_ANTILOCK,
    )


def _random_state(vehicle: Vehicle, rng: np.random.Generator) -> FloatArray:
    """A car anywhere within what a road car does: turning, rolling, pitching, with slipping wheels."""
    x = rest_state(vehicle)
    x[SPEED] = rng.uniform(0.5, 40.0)
    x[:2] = rng.uniform(-10.0, 10.0, 2)
    x[STEERING] = rng.uniform(-0.3, 0.3)
    x[[YAW, YAW_RATE]] = rng.uniform(-0.5, 0.5, 2)
    x[ROLL : PITCH + 2] += rng.uniform(-0.05, 0.05, 4)
    x[LATERAL_SPEED] = rng.uniform(-0.3, 0.3)
    x[[HEIGHT, VERTICAL_SPEED]] += rng.uniform(-0.01, 0.01, 2)
    for axle in (FRONT, REAR):
        x[axle : axle + 5] += rng.uniform(-1.0, 1.0, 5) * (0.005, 0.1, 0.1, 0.005, 0.1)
    x[WHEELS : WHEELS + 4] = x[SPEED] / vehicle.R_w * rng.uniform(0.1, 1.1, 4)
    x[JOINTS:] = rng.uniform(-0.01, 0.01, 2)
    return x


@pytest.mark.parametrize("number", [1, 2, 3])
def test_right_hand_side(number: int) -> None:
    theirs, vehicle, tyre = _parameters(number)
    rng = np.random.default_rng(number)
    out = np.empty(STATES)
    for _ in range(200):
        x = _random_state(vehicle, rng)
        power = vehicle.a_max * min(1.0, vehicle.v_switch / x[SPEED])
        acceleration = rng.uniform(-vehicle.a_max, power)
        steering_rate = rng.uniform(-0.3, 0.3)
        full_derivative(x, _torques(vehicle, acceleration, steering_rate), vehicle, tyre, 1.0, out)
        expected = vehicle_dynamics_mb(x.tolist(), [steering_rate, acceleration], theirs)
        np.testing.assert_allclose(out, expected, rtol=1e-9, atol=1e-9)


def test_parameters_are_those_of_the_source() -> None:
    _, vehicle, tyre = _parameters(2)
    assert vehicle == BMW_320I
    assert tyre == SOURCE_TYRE
    assert {name for name in Tyre._fields if getattr(tyre, name) != getattr(TYRE, name)} == {"p_hx1", "p_vx1", "r_vy1"}
