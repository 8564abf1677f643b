"""Motion of the car, headings on their grid, and trajectories."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from skd_sim.world.state import Trajectory, braking_distance, heading_of, next_speed, on_grid, travelled

SPEED = 25.0 / 3.0  # m/s, 30 km/h
STEP = 0.3  # s


@pytest.mark.parametrize("deceleration", [1.0, 3.5, 7.0])
def test_stopping_distance_of_the_noiseless_car(deceleration: float) -> None:
    """The trapezoid is exact for uniform braking; only the step in which the car stops is not uniform."""
    speed, distance, steps = SPEED, 0.0, 0
    while speed > 0.0:
        after = next_speed(speed, -deceleration, 0.0, STEP)
        distance += travelled(speed, after, STEP)
        speed = after
        steps += 1
    full = math.floor(SPEED / (deceleration * STEP))  # whole steps of uniform braking
    rest = SPEED - full * deceleration * STEP  # speed at the start of the last one
    uniform = (SPEED**2 - rest**2) / (2.0 * deceleration)
    assert steps == math.ceil(SPEED / (deceleration * STEP))
    assert distance == pytest.approx(uniform + 0.5 * STEP * rest, rel=1e-12)
    # The last step stretches the last rest²/2a to rest·Δt/2.
    assert 0.0 <= distance - braking_distance(SPEED, deceleration) <= 0.5 * STEP * rest


@given(
    speed=st.floats(0.0, 60.0),
    acceleration=st.floats(-50.0, 50.0),
    noise=st.floats(-0.5, 0.5),
    step=st.floats(0.01, 2.0),
)
def test_the_car_never_reverses(speed: float, acceleration: float, noise: float, step: float) -> None:
    after = next_speed(speed, acceleration, noise, step)
    assert after >= 0.0
    assert travelled(speed, after, step) >= 0.0
    assert after == pytest.approx(max(0.0, speed * (1.0 + noise) + step * acceleration), abs=1e-9)


@given(st.floats(-100.0, 100.0))
def test_a_heading_of_the_grid_survives_the_quaternion_to_the_last_bit(heading: float) -> None:
    kept = float(on_grid(heading))
    assert heading_of(math.sin(0.5 * kept), math.cos(0.5 * kept)) == kept
    assert -math.pi < kept <= math.pi
    assert abs(math.remainder(kept - heading, math.tau)) < 2e-12
    assert on_grid(kept) == kept


POINTS = np.arange(10.0).reshape(5, 2)


def test_positions_are_a_copy_and_read_only() -> None:
    points = POINTS.copy()
    trajectory = Trajectory(points, 0.3)
    points[0, 0] = 99.0
    assert trajectory.positions[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        trajectory.positions[0, 0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        trajectory.time_step = 1.0  # type: ignore[misc]


@pytest.mark.parametrize("points", [np.empty((0, 2)), np.empty((3, 0)), np.zeros(3), np.zeros((2, 2, 2))])
def test_wrong_shape(points: np.ndarray) -> None:
    with pytest.raises(ValueError, match="n × d"):
        Trajectory(points, 0.3)
