from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from skd_sim.world.state import braking_distance, next_speed, travelled

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
