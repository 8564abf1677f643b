"""Placement of the crossing in another map, and CARLA's messages as states and controls."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from skd_sim.simulators.carla import (
    Placement,
    adversary_from_odometry,
    pedals,
    walker_control,
)
from skd_sim.world.state import AdversaryState, CarState

COORDINATES = st.floats(-1e3, 1e3)
PLACEMENTS = st.builds(Placement, COORDINATES, COORDINATES, st.floats(-7.0, 7.0))


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """x, y, z, w of a rotation about z, then y, then x, by multiplying the three quaternions."""

    def multiply(p: Any, q: Any) -> Any:
        a, b = np.array(p[:3]), np.array(q[:3])
        return (*(p[3] * b + q[3] * a + np.cross(a, b)), p[3] * q[3] - a @ b)

    about = [
        (*(math.sin(0.5 * angle) * np.eye(3)[axis]), math.cos(0.5 * angle))
        for axis, angle in ((2, yaw), (1, pitch), (0, roll))
    ]
    return multiply(multiply(about[0], about[1]), about[2])


def odometry(x: float, y: float, turn: tuple[float, float, float], vx: float, vy: float) -> Any:
    orientation = SimpleNamespace(**dict(zip("xyzw", quaternion(*turn), strict=True)))
    return SimpleNamespace(
        pose=SimpleNamespace(pose=SimpleNamespace(position=SimpleNamespace(x=x, y=y, z=0.4), orientation=orientation)),
        twist=SimpleNamespace(twist=SimpleNamespace(linear=SimpleNamespace(x=vx, y=vy, z=0.0))),
    )


@given(placement=PLACEMENTS, x=COORDINATES, y=COORDINATES, heading=st.floats(-math.pi, math.pi))
def test_there_and_back(placement: Placement, x: float, y: float, heading: float) -> None:
    assert placement.point_to_crossing(*placement.point_to_map(x, y)) == pytest.approx((x, y), abs=1e-9)
    assert placement.vector_to_crossing(*placement.vector_to_map(x, y)) == pytest.approx((x, y), abs=1e-9)
    back = placement.car_to_crossing(CarState(*placement.point_to_map(x, y), heading + placement.yaw, 3.0))
    assert back[:2] == pytest.approx((x, y), abs=1e-9)
    assert math.cos(back.heading - heading) == pytest.approx(1.0)
    assert back.speed == 3.0


def test_the_twist_of_a_walker_is_in_its_own_axes() -> None:
    """One who faces South in the map and goes ahead goes East in a crossing whose x axis points South."""
    placement = Placement(100.0, 50.0, -math.pi / 2)
    walker = adversary_from_odometry(odometry(100.0, 49.0, (0.0, 0.0, -math.pi / 2), 2.5, 0.0), placement)
    assert walker == pytest.approx((1.0, 0.0, 2.5, 0.0, 0.0), abs=1e-12)
    sideways = adversary_from_odometry(odometry(100.0, 49.0, (0.0, 0.0, 0.0), 2.5, 0.0), placement)
    assert sideways == pytest.approx(AdversaryState(1.0, 0.0, 0.0, 2.5), abs=1e-12)


@given(acceleration=st.floats(-30.0, 30.0))
def test_pedals(acceleration: float) -> None:
    throttle, brake = pedals(acceleration, 4.0, 8.0)
    assert 0.0 <= throttle <= 1.0
    assert 0.0 <= brake <= 1.0
    assert throttle == 0.0 or brake == 0.0
    if -8.0 <= acceleration <= 4.0:
        assert 4.0 * throttle - 8.0 * brake == pytest.approx(acceleration)


@given(placement=PLACEMENTS, vx=st.floats(-3.0, 3.0), vy=st.floats(-3.0, 3.0))
def test_walker_control(placement: Placement, vx: float, vy: float) -> None:
    x, y, speed = walker_control((vx, vy), placement)
    assert math.hypot(x, y) == pytest.approx(1.0)
    wanted = placement.vector_to_map(vx, vy)
    assert (speed * x, speed * y) == pytest.approx(wanted, abs=1e-9)
