"""What an inertial unit measures, against circles and straight lines in closed form."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from skd_sim.world.sensors import Inertia, InertialUnit
from skd_sim.world.state import CarState

GRAVITY = 9.80665  # m/s², 3rd CGPM (1901)
MILLISECOND = 1_000_000  # ns


def measured(*states: tuple[int, CarState]) -> list[Inertia]:
    unit = InertialUnit()
    return [unit.measure(car, stamp) for stamp, car in states]


@given(heading=st.floats(-3.0, 3.0), speed=st.floats(0.0, 20.0), period=st.integers(5, 300))
def test_without_forces_there_is_only_gravity(heading, speed, period):
    """REP 145: an accelerometer at rest, or in uniform motion, shows g upwards."""
    cars = [(tick * period * MILLISECOND, CarState(0.0, 0.0, heading, speed)) for tick in range(3)]
    assert measured(*cars) == [Inertia(heading, 0.0, (0.0, 0.0, GRAVITY))] * 3


@given(speed=st.floats(1.0, 20.0), radius=st.floats(5.0, 100.0), left=st.booleans(), start=st.floats(-3.1, 3.1))
def test_a_circle(speed, radius, left, start):
    """v/r and v²/r, to the inside, across the jump of the heading at π, too."""
    rate = speed / radius if left else -speed / radius
    headings = [math.remainder(start + rate * 0.05 * k, 2.0 * math.pi) for k in range(20)]
    cars = [(50 * MILLISECOND * k, CarState(0.0, 0.0, heading, speed)) for k, heading in enumerate(headings)]
    for inertia in measured(*cars)[1:]:
        assert inertia.yaw_rate == pytest.approx(rate, rel=1e-9)
        assert inertia.acceleration == pytest.approx((0.0, speed * rate, GRAVITY), rel=1e-9)
