"""The multi-body model against the authors' own implementation, commonroad-vehicle-models."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from skd_sim.arrays import FloatArray
from skd_sim.scenario.scenario import load_scenario
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
from skd_sim.world.dynamics.multi_body_car import MultiBodyCar, rest_state
from skd_sim.world.state import CarState
from vehiclemodels.init_mb import init_mb
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


def test_car_stops_as_an_adaptive_integration_of_their_equations_does() -> None:
    """The whole manoeuvre: our equations and steps against their equations and LSODA at a tolerance of 1e-8."""
    theirs, vehicle, _ = _parameters(2)
    for name in ("p_hx1", "p_vx1", "r_vy1"):
        setattr(theirs.tire, name, 0.0)
    duration, deceleration, start = 1.8, 4.0, 25.0 / 3.0
    state = np.array(init_mb([0.0, 0.0, 0.0, start, 0.0, 0.0, 0.0], theirs), dtype=float)
    resting = rest_state(vehicle)
    state[[PITCH, HEIGHT]] = resting[[PITCH, HEIGHT]]
    np.testing.assert_allclose(np.delete(state, [SPEED, *range(WHEELS, WHEELS + 4)])[5:], np.delete(
        resting, [SPEED, *range(WHEELS, WHEELS + 4)])[5:], atol=1e-12)  # fmt: skip
    solution = solve_ivp(
        lambda _, x: vehicle_dynamics_mb(x.tolist(), [0.0, -deceleration], theirs),
        (0.0, duration),
        state,
        method="LSODA",
        rtol=1e-8,
        atol=1e-8,
    )
    assert solution.success
    scenario = load_scenario("crossing_multi_body")
    car = replace(scenario.car, acceleration_noise=0.0, brake_delay=0.0, brake_rate=1000.0, antilock=False)
    ours = MultiBodyCar(replace(scenario, car=car))
    ours.reset(CarState(0.0, 0.0, 0.0, start))
    # Their torque is m·R·a; ours allows for the wheels' inertia.
    command = deceleration * vehicle.m / (vehicle.m + 4.0 * vehicle.I_y_w / vehicle.R_w**2)
    path = ours.advance(-command, duration, ours.draw(np.random.default_rng(0)))
    ramp = 0.5 * deceleration / 1000.0  # s that the fastest brake a scenario can have comes later than theirs
    assert path[-1, 3] == pytest.approx(solution.y[SPEED, -1] + deceleration * ramp, abs=2e-3)
    assert path[-1, 0] == pytest.approx(solution.y[0, -1] + deceleration * ramp * duration, rel=1e-3)
    np.testing.assert_allclose(ours.state[PITCH], solution.y[PITCH, -1], rtol=0.02)
    assert math.isclose(path[-1, 1], 0.0, abs_tol=1e-12)
