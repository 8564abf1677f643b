from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from skd_sim.world.state import braking_distance, draw_relative, next_speed, travelled

SPEED = 25.0 / 3.0  # m/s, 30 km/h
STEP = 0.3  # s


def test_safe_distance_of_the_paper() -> None:
    assert braking_distance(SPEED, 3.5) == pytest.approx(9.921, abs=5e-4)
    assert braking_distance(SPEED, 3.5) == pytest.approx((25.0 / 3.0) ** 2 / 7.0, rel=1e-15)


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


def test_moments_of_the_noise() -> None:
    """U[−h, h]: mean 0, variance h²/3, fourth moment h⁴/5."""
    rng = np.random.default_rng(20260101)
    n, h = 200_000, 0.05
    draws = np.array([draw_relative(h, rng) for _ in range(n)])
    assert np.abs(draws).max() <= h
    variance = h**2 / 3.0
    assert abs(draws.mean()) < 4.0 * math.sqrt(variance / n)
    error = math.sqrt((h**4 / 5.0 - variance**2) / n)  # standard error of the mean of squares
    assert abs((draws**2).mean() - variance) < 4.0 * error
    # Kolmogorov–Smirnov against the uniform distribution; 1.95/√n is the 0.1 % point.
    ranks = (np.arange(n) + 0.5) / n
    assert np.abs(np.sort(draws) / (2.0 * h) + 0.5 - ranks).max() < 1.95 / math.sqrt(n)


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
