"""CARLA's agent, and what is handed to and from its simulator."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from skd_sim.controllers import cal
from skd_sim.ros import carla_bridge
from skd_sim.scenario.road import HEADING_NORTH
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.state import AdversaryState, CarState, next_speed, travelled

CROSSING = load_scenario("crossing")


@pytest.mark.parametrize(
    ("distance", "angle", "factor"),
    [
        (11.99, 0.0, 0.0),
        (11.99, -0.499, 0.0),
        (11.99, 0.501, 1.0),
        (12.0, 0.0, 12.0 / 70.0),
        (34.99, 0.149, 34.99 / 70.0),
        (34.99, -0.151, 1.0),
        (35.0, 0.0, 1.0),
    ],
)
def test_published_zones(distance, angle, factor):
    assert cal.speed_factor(distance, angle) == pytest.approx(factor)


def agent() -> cal.CarlaAgent:
    controller = cal.CarlaAgent()
    controller.reset(CROSSING, np.random.default_rng(0))
    return controller


def test_full_stop_for_one_near_on_the_lane_and_none_beside_it():
    car = CarState(0.0, -10.0, HEADING_NORTH, 25.0 / 3.0)
    assert agent().command(car, AdversaryState(1.7, 0.0, 0.0, 0.0)) == -CROSSING.car.deceleration
    assert agent().command(car, AdversaryState(1.8, 0.0, 0.0, 0.0)) > 0.0
    behind = AdversaryState(0.0, -20.0, 0.0, 0.0)
    assert agent().command(car, behind) > 0.0


def cruise(controller: cal.CarlaAgent, ahead: float, ticks: int) -> float:
    """Keep an adversary at a distance; return the speed that the car settles at, m/s."""
    y, speed = 0.0, 25.0 / 3.0
    for _ in range(ticks):
        car, adversary = CarState(0.0, y, HEADING_NORTH, speed), AdversaryState(0.0, y + ahead, 0.0, 0.0)
        after = next_speed(speed, controller.command(car, adversary), 0.0, 0.3)
        y += travelled(speed, after, 0.3)
        speed = after
    return speed * 3.6


def test_target_speeds():
    """36 km/h on a free road, 36·30/70 km/h with an adversary 30 m ahead."""
    assert cruise(agent(), 1e4, 200) == pytest.approx(36.0, abs=0.5)
    assert cruise(agent(), 30.0, 300) == pytest.approx(36.0 * 30.0 / 70.0, abs=1.0)


def test_pedals():
    assert cal.pedal_acceleration(0.0, 1.0, 8.0, 3.5) == -3.5
    assert cal.pedal_acceleration(0.8, 0.5, 8.0, 3.5) == -1.75  # any brake overrides the throttle
    assert cal.pedal_acceleration(0.5, 0.0, 0.0, 3.5) == 0.5 * cal.MAXIMUM_ACCELERATION
    assert cal.pedal_acceleration(0.0, 0.0, 10.0, 3.5) == -10.0 * cal.DRAG


@pytest.mark.parametrize(("time_step", "count"), [(0.3, 6), (0.05, 1), (0.02, 1), (0.1, 2), (0.32, 6)])
def test_decisions_of_a_tick(time_step, count):
    steps, duration = cal.sub_steps(time_step)
    assert steps == count
    assert steps * duration == pytest.approx(time_step)


def test_pid_of_a_ramp():
    """For error e = k·t sampled at the end of each step: P·k·t + I·Σ k·t·Δt + D·k, by hand."""
    pid = cal.Pid(2.0, 3.0, 5.0, integral_limit=1e9)
    step, slope = 0.05, 4.0
    outputs = [pid.step(slope * step * n, step) for n in range(1, 11)]
    integral = slope * step * step * 55  # 1 + 2 + … + 10
    assert outputs[-1] == pytest.approx(2.0 * slope * step * 10 + 3.0 * integral + 5.0 * slope)
    assert outputs[0] == pytest.approx(2.0 * slope * step + 3.0 * slope * step * step)  # no derivative yet


def test_pid_integral_is_clamped_and_survives_a_pause():
    pid = cal.Pid(0.0, 1.0, 1.0, integral_limit=20.0)
    for _ in range(1000):
        output = pid.step(1.0, 0.05)
    assert output == 20.0
    pid.pause()
    assert pid.step(-1.0, 1.0) == 19.0  # no jump of the derivative
    pid.reset()
    assert pid.step(-1.0, 1.0) == -1.0


COORDINATES = st.floats(-1e3, 1e3)
PLACEMENTS = st.builds(carla_bridge.Placement, COORDINATES, COORDINATES, st.floats(-7.0, 7.0))


def odometry(x: float, y: float, yaw: float, vx: float, vy: float) -> Any:
    orientation = SimpleNamespace(x=0.0, y=0.0, z=math.sin(0.5 * yaw), w=math.cos(0.5 * yaw))
    return SimpleNamespace(
        pose=SimpleNamespace(pose=SimpleNamespace(position=SimpleNamespace(x=x, y=y, z=0.4), orientation=orientation)),
        twist=SimpleNamespace(twist=SimpleNamespace(linear=SimpleNamespace(x=vx, y=vy, z=0.0))),
    )


@given(placement=PLACEMENTS, x=COORDINATES, y=COORDINATES, heading=st.floats(-math.pi, math.pi))
def test_there_and_back(placement: carla_bridge.Placement, x: float, y: float, heading: float) -> None:
    assert placement.point_to_crossing(*placement.point_to_map(x, y)) == pytest.approx((x, y), abs=1e-9)
    assert placement.vector_to_crossing(*placement.vector_to_map(x, y)) == pytest.approx((x, y), abs=1e-9)
    said = odometry(*placement.point_to_map(x, y), heading + placement.yaw, 3.0, 0.0)
    back = carla_bridge.car_from_odometry(said, placement)
    assert back[:2] == pytest.approx((x, y), abs=1e-9)
    assert math.cos(back.heading - heading) == pytest.approx(1.0)
    assert back.speed == 3.0


def test_the_twist_of_a_walker_is_in_its_own_axes() -> None:
    """One who faces South in the map and goes ahead goes East in a crossing whose x axis points South."""
    placement = carla_bridge.Placement(100.0, 50.0, -math.pi / 2)
    walker = carla_bridge.adversary_from_odometry(odometry(100.0, 49.0, -math.pi / 2, 2.5, 0.0), placement)
    assert walker == pytest.approx((1.0, 0.0, 2.5, 0.0, 0.0), abs=1e-12)
    sideways = carla_bridge.adversary_from_odometry(odometry(100.0, 49.0, 0.0, 2.5, 0.0), placement)
    assert sideways == pytest.approx(AdversaryState(1.0, 0.0, 0.0, 2.5), abs=1e-12)


@given(acceleration=st.floats(-30.0, 30.0))
def test_pedals_conversion(acceleration: float) -> None:
    throttle, brake = carla_bridge.pedals(acceleration, 4.0, 8.0)
    assert 0.0 <= throttle <= 1.0
    assert 0.0 <= brake <= 1.0
    assert throttle == 0.0 or brake == 0.0
    if -8.0 <= acceleration <= 4.0:
        assert 4.0 * throttle - 8.0 * brake == pytest.approx(acceleration)


@given(placement=PLACEMENTS, vx=st.floats(-3.0, 3.0), vy=st.floats(-3.0, 3.0))
@example(placement=carla_bridge.Placement(0.0, 0.0, 0.0), vx=5e-324, vy=5e-324)
def test_walker_control(placement: carla_bridge.Placement, vx: float, vy: float) -> None:
    x, y, speed = carla_bridge.walker_control((vx, vy), placement)
    assert math.hypot(x, y) == pytest.approx(1.0)
    wanted = placement.vector_to_map(vx, vy)
    assert (speed * x, speed * y) == pytest.approx(wanted, abs=1e-9)


@pytest.mark.parametrize(("angle", "expected"), [(0.305, -0.25), (-0.61, 0.5), (2.0, -1.0), (0.0, 0.0)])
def test_carla_steers_to_the_right_in_shares_of_full_lock(angle: float, expected: float) -> None:
    assert carla_bridge.steer(angle, 1.22) == expected
