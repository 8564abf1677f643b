"""The multi-body model against the authors' own implementation, commonroad-vehicle-models."""

from __future__ import annotations

import numpy as np
from skd_sim.world.dynamics.multi_body import (
    BMW_320I,
    FRONT,
    HEIGHT,
    PITCH,
    PITCH_RATE,
    REAR,
    SPEED,
    STATES,
    TYRE,
    VERTICAL_SPEED,
    WHEELS,
    WheelTorques,
    derivative,
    rest_state,
)
from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb
from vehiclemodels.vehicle_parameters import setup_vehicle_parameters

PLACES = [0, 3, 8, 9, 11, 12, 16, 17, 21, 22, 23, 25]
"""Of our states among the 29 of the source; of the wheels, those on the left."""


def test_right_hand_side_is_that_of_a_car_that_goes_straight() -> None:
    v, rng, out = BMW_320I, np.random.default_rng(1), np.empty(STATES)
    theirs = setup_vehicle_parameters(2)
    theirs.tire.p_hx1 = theirs.tire.p_vx1 = theirs.tire.r_vy1 = 0.0  # by which a car at rest would creep and pull
    for _ in range(300):
        x = rest_state(v)
        x[SPEED] = rng.uniform(0.5, 40.0)
        for place in (PITCH, PITCH_RATE, HEIGHT, VERTICAL_SPEED, FRONT, FRONT + 1, REAR, REAR + 1):
            x[place] += rng.uniform(-0.01, 0.01)
        x[WHEELS:] = x[SPEED] / v.R_w * rng.uniform(0.1, 1.1, 2)
        acceleration = rng.uniform(-v.a_max, v.a_max * min(1.0, v.v_switch / x[SPEED]))
        force = 0.5 * v.m * v.R_w
        brake, drive = max(0.0, -acceleration) * force, max(0.0, acceleration) * force
        shares = v.T_sb * brake, (1.0 - v.T_sb) * brake, v.T_se * drive, (1.0 - v.T_se) * drive
        derivative(x, WheelTorques(*shares, 2.0, 3.0), v, TYRE, 1.0, out)
        whole = np.zeros(29)
        whole[PLACES] = x
        whole[[24, 26]] = x[WHEELS:]
        expected = np.array(vehicle_dynamics_mb(whole.tolist(), [0.0, acceleration], theirs))
        np.testing.assert_allclose(out, expected[PLACES], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(np.delete(expected, [*PLACES, 24, 26]), 0.0, atol=1e-9)


def test_parameters_are_those_of_the_source() -> None:
    theirs = setup_vehicle_parameters(2)
    flat = {**vars(theirs), "a_max": theirs.longitudinal.a_max, "v_switch": theirs.longitudinal.v_switch}
    assert BMW_320I._asdict() == {name: flat[name] for name in BMW_320I._fields}
    assert TYRE._asdict() == {name: getattr(theirs.tire, name) for name in TYRE._fields}
