"""The multi-body car: published stopping distances, energy, load transfer, and CommonRoad's own right-hand side."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from skd_sim import CarState, Scenario, load_scenario
from skd_sim.world.dynamics import multi_body as body
from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb
from vehiclemodels.vehicle_dynamics_std import vehicle_dynamics_std
from vehiclemodels.vehicle_parameters import setup_vehicle_parameters

BASE = load_scenario("crossing_multi_body")
TICK = BASE.time_step
WET = 0.65
FOOT, MPH, KMH = 0.3048, 0.44704, 1.0 / 3.6
START = 25.0 / 3.0
FULL = -BASE.car.brake_limit

# Published, all with the brakes already at work when the measurement begins:
# 2013 BMW 320i, dry, 60 mph: 106 ft (Motor Trend, first test, July 2013).
DRY_60_MPH = 106.0 * FOOT


def scenario(friction: float = 1.0, **changes: Any) -> Scenario:
    """The shipped scenario without noise, with other values."""
    car = replace(BASE.car, **{"acceleration_noise": 0.0, **changes})
    return replace(BASE, road=replace(BASE.road, friction=friction), car=car)


def drive(setting, speed, commands, *, duration=TICK, step=0.001):
    """Path under a list of commands, from the origin northwards, and the car at its end."""
    car = body.MultiBodyCar(setting, step=step)
    car.reset(CarState(0.0, 0.0, math.pi / 2, speed))
    rng = np.random.default_rng(0)
    parts = [car.advance((command, 0.0), duration, car.draw(rng)) for command in commands]
    return np.concatenate([parts[0], *(part[1:] for part in parts[1:])]), car


def stopping_distance(setting: Scenario, speed: float, command: float = FULL, step: float = 0.001) -> float:
    """Metres from the command to standstill."""
    path, _ = drive(setting, speed, [command] * 60, step=step)
    assert path[-1, 3] == 0.0
    return float(path[-1, 1])


def established_distance(friction: float, speed: float) -> float:
    """Metres from `speed` to standstill of a car that has been braking fully since 5 m/s more, as testers measure."""
    path, _ = drive(scenario(friction), speed + 5.0, [FULL] * 60)
    falling = path[::-1]
    return float(path[-1, 1] - np.interp(speed, falling[:, 3], falling[:, 1]))


def test_dry_stopping_distance_is_the_published_one() -> None:
    assert established_distance(1.0, 60.0 * MPH) == pytest.approx(DRY_60_MPH, rel=0.1)
    # At the friction limit the deceleration hardly depends on the speed, so the distance goes with its square.
    published = DRY_60_MPH * (START / (60.0 * MPH)) ** 2
    assert established_distance(1.0, START) == pytest.approx(published, rel=0.1)


@settings(max_examples=60)
@given(
    commands=st.lists(st.floats(-15.0, 0.0), min_size=1, max_size=12),
    friction=st.floats(0.1, 1.2),
    speed=st.floats(0.0, 30.0),
    antilock=st.booleans(),
)
def test_energy_never_rises_without_throttle(commands, friction, speed, antilock):
    """Kinetic energy of travel and of the wheels' spin, after every 10 ms.

    The speed alone may rise by what the wheels, as flywheels, give back: less than a millionth.
    """
    car = body.MultiBodyCar(scenario(friction, antilock=antilock))
    car.reset(CarState(0.0, 0.0, 0.0, speed))
    rng = np.random.default_rng(0)
    spin = car.state[body.WHEELS :]
    energy = 0.5 * body.BMW_320I.m * speed**2 + body.BMW_320I.I_y_w * float(spin @ spin)
    for command in commands:
        for _ in range(30):
            path = car.advance((command, 0.0), 0.01, car.draw(rng))
            assert path[1, 3] <= path[0, 3] * (1.0 + 1e-6)
            spin = car.state[body.WHEELS :]
            after = 0.5 * body.BMW_320I.m * car.state[body.SPEED] ** 2 + body.BMW_320I.I_y_w * float(spin @ spin)
            assert after <= energy * (1.0 + 1e-12)
            energy = after


@pytest.mark.parametrize("deceleration", [1.0, 3.5, 6.0])
def test_load_transfer(deceleration: float) -> None:
    """Front axle gains m·a·h/L, rear axle loses as much.

    The source takes for h the height of the sprung mass's centre, which the tyres' deflection lowers to 0.597 m; with
    that of the whole car's centre, 0.575 m, the transfer would be 4 % less.
    """
    v = body.BMW_320I
    _, car = drive(scenario(), 30.0, [-deceleration] * 8)
    rest = body.rest_state()
    front = 2.0 * v.K_zt * (car.state[body.FRONT] - rest[body.FRONT])
    rear = 2.0 * v.K_zt * (car.state[body.REAR] - rest[body.REAR])
    wheelbase = v.a + v.b
    height = v.h_s - rest[body.HEIGHT]
    assert front == pytest.approx(v.m * deceleration * height / wheelbase, rel=0.01)
    assert front == pytest.approx(v.m * deceleration * 0.575 / wheelbase, rel=0.05)
    assert rear == pytest.approx(-front, rel=0.01)
    assert car.state[body.PITCH] < rest[body.PITCH]  # nose down


@pytest.mark.parametrize("friction", [1.0, WET, 0.3])
def test_antilock_keeps_the_wheels_turning_and_stops_sooner(friction: float) -> None:
    _, car = drive(scenario(friction), 20.0, [FULL] * 3)
    slip = 1.0 - body.BMW_320I.R_w * car.state[body.WHEELS :] / car.state[body.SPEED]
    assert slip.max() < 2.0 * body.peak_slip(friction)
    _, locked = drive(scenario(friction, antilock=False), 20.0, [FULL] * 3)
    assert locked.state[body.WHEELS + 1] == 0.0
    assert stopping_distance(scenario(friction), 20.0) < stopping_distance(scenario(friction, antilock=False), 20.0)


@pytest.mark.parametrize(("delay", "rate", "step"), [(0.1, 50.0, 0.001), (0.25, 10.0, 0.001), (0.0, 20.0, 0.0005)])
def test_brake_waits_and_then_ramps(delay: float, rate: float, step: float) -> None:
    brake = body.new_brake(delay, step)
    times = np.arange(1, round(1.0 / step) + 1) * step
    applied = np.array([body.apply_brake(brake, 6.0, rate, step) for _ in times])
    np.testing.assert_allclose(applied, np.clip((times - delay) * rate, 0.0, 6.0), atol=rate * step + 1e-9)
    released = np.array([body.apply_brake(brake, 0.0, rate, step) for _ in times])
    np.testing.assert_allclose(released, np.clip(6.0 - (times - delay) * rate, 0.0, 6.0), atol=rate * step + 1e-9)


PLACES = [0, 3, 8, 9, 11, 12, 16, 17, 21, 22, 23, 25]
"""Of our states among the 29 of the source; of the wheels, those on the left."""


def test_right_hand_side_is_that_of_a_car_that_goes_straight() -> None:
    v, rng, out = body.BMW_320I, np.random.default_rng(1), np.empty(body.STATES)
    theirs = setup_vehicle_parameters(2)
    theirs.tire.p_hx1 = theirs.tire.p_vx1 = theirs.tire.r_vy1 = 0.0  # by which a car at rest would creep and pull
    for _ in range(300):
        x = body.rest_state()
        x[body.SPEED] = rng.uniform(0.5, 40.0)
        sprung = (body.PITCH, body.PITCH_RATE, body.HEIGHT, body.VERTICAL_SPEED)
        for place in (*sprung, body.FRONT, body.FRONT + 1, body.REAR, body.REAR + 1):
            x[place] += rng.uniform(-0.01, 0.01)
        x[body.WHEELS :] = x[body.SPEED] / v.R_w * rng.uniform(0.1, 1.1, 2)
        acceleration = rng.uniform(-v.a_max, v.a_max * min(1.0, v.v_switch / x[body.SPEED]))
        force = 0.5 * v.m * v.R_w
        brake, drive = max(0.0, -acceleration) * force, max(0.0, acceleration) * force
        shares = v.T_sb * brake, (1.0 - v.T_sb) * brake, v.T_se * drive, (1.0 - v.T_se) * drive
        body.derivative(x, body.WheelTorques(shares[:2], shares[2:], (2.0, 3.0)), 1.0, out)
        whole = np.zeros(29)
        whole[PLACES] = x
        whole[[24, 26]] = x[body.WHEELS :]
        expected = np.array(vehicle_dynamics_mb(whole.tolist(), [0.0, acceleration], theirs))
        np.testing.assert_allclose(out, expected[PLACES], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(np.delete(expected, [*PLACES, 24, 26]), 0.0, atol=1e-9)


def test_parameters_are_those_of_the_source() -> None:
    theirs = setup_vehicle_parameters(2)
    flat = vars(theirs.longitudinal) | vars(theirs) | {"v_max": theirs.steering.v_max}
    assert body.BMW_320I._asdict() == {name: flat[name] for name in body.BMW_320I._fields}
    assert body.TYRE._asdict() == {name: getattr(theirs.tire, name) for name in body.TYRE._fields}


THEIRS = [0, body.LEFT, body.ANGLE, body.SPEED, body.HEADING, body.YAW_RATE, body.DRIFT, body.WHEELS, body.WHEELS + 1]
"""Of our states those of the source's drift model, in its order."""


def test_right_hand_side_of_a_car_that_steers_is_that_of_the_drift_model() -> None:
    v, rng, out = body.BMW_320I, np.random.default_rng(2), np.empty(body.STATES)
    theirs = setup_vehicle_parameters(2)
    for offset in ("p_hx1", "p_vx1", "r_hx1", "r_hy1", "r_vy1", "r_by3"):  # these push, or tell left from right
        setattr(theirs.tire, offset, 0.0)
    theirs.I_y_w *= 2.0  # of the two wheels of an axle
    for _ in range(300):
        x, speed = np.zeros(body.STATES), rng.uniform(2.0, 40.0)
        places = [body.LEFT, body.HEADING, body.YAW_RATE, body.DRIFT, body.ANGLE]
        x[places] = rng.uniform(-1.0, 1.0, 5) * (9.0, 3.0, 1.5, 0.4, 0.6)
        x[body.SPEED], x[body.WHEELS :] = speed, speed / v.R_w * rng.uniform(0.1, 1.1, 2)
        acceleration = rng.uniform(-v.a_max, v.a_max * min(1.0, v.v_switch / speed))
        force = 0.5 * v.m * v.R_w
        brake, drive = max(0.0, -acceleration) * force, max(0.0, acceleration) * force
        shares = v.T_sb * brake, (1.0 - v.T_sb) * brake, v.T_se * drive, (1.0 - v.T_se) * drive
        body.derivative(x, body.WheelTorques(shares[:2], shares[2:], (2.0, 3.0), acceleration, steered=True), 1.0, out)
        expected = np.array(vehicle_dynamics_std(x[THEIRS].tolist(), [0.0, acceleration], theirs))
        np.testing.assert_allclose(out[THEIRS], expected, rtol=1e-9, atol=1e-9)


def steered(setting: Scenario, speed: float, commands: Any, step: float = 0.001) -> np.ndarray:
    """Path from the origin northwards under commands of a tick each."""
    car = body.MultiBodyCar(setting, step=step)
    car.reset(CarState(0.0, 0.0, math.pi / 2, speed))
    quiet = car.draw(np.random.default_rng(0))
    return np.concatenate([car.advance(command, TICK, quiet)[1:] for command in commands])


@pytest.mark.parametrize("speed", [0.2, 2.0, 8.0])
def test_a_car_whose_axles_slip_alike_drives_the_circle_of_its_wheelbase(speed: float) -> None:
    """Tyres are as stiff as they are loaded, so at small slip it neither under- nor oversteers."""
    path = steered(scenario(), speed, [(0.0, 0.03)] * 20)[200:]
    turned = math.remainder(path[-1, 2] - path[0, 2], math.tau)
    driven = np.hypot(*np.diff(path[:, :2], axis=0).T).sum()
    assert turned / driven == pytest.approx(math.tan(0.03) / (body.BMW_320I.a + body.BMW_320I.b), rel=0.02)


@settings(max_examples=30)
@example(commands=[(-4.0, 0.5)], friction=0.375, speed=6.0)
@given(
    commands=st.lists(st.tuples(st.floats(-15.0, 3.0), st.floats(-0.6, 0.6)), min_size=1, max_size=8),
    friction=st.floats(0.3, 1.0),
    speed=st.floats(0.0, 25.0),
)
def test_tyres_bound_what_a_car_that_steers_does(commands, friction, speed):
    """Sliding and braking together push by at most 6 % more than braking alone, as by the source's formulas.

    A mirrored command drives the mirrored path, and steps half as long the same one.
    """
    commands = [(0.0, 0.1), *commands]
    path = steered(scenario(friction), speed, commands)
    velocity = np.diff(path[:, :2], axis=0) / 0.01
    assert (np.hypot(*np.diff(velocity, axis=0).T) / 0.01).max() <= 1.06 * friction * body.TYRE.p_dx1 * 9.81 + 0.05
    mirrored = steered(scenario(friction), speed, [(acceleration, -angle) for acceleration, angle in commands])
    np.testing.assert_allclose(mirrored[:, :2] * (-1.0, 1.0), path[:, :2], atol=1e-6)
    np.testing.assert_allclose(np.sin(mirrored[:, 2]), np.sin(path[:, 2]), atol=1e-6)
    finer = steered(scenario(friction), speed, commands, step=0.0005)
    np.testing.assert_allclose(finer[-1, :2], path[-1, :2], atol=0.01)


def test_a_steered_car_starts_where_the_straight_one_is() -> None:
    straight, bent = (steered(scenario(), 8.0, [(-2.0, 0.0)] * 2 + [(-2.0, a)] * 2) for a in (0.0, 1e-12))
    np.testing.assert_allclose(bent, straight, atol=2e-3)  # the pitch is lost
    assert np.array_equal(bent[: len(bent) // 2], straight[: len(bent) // 2])
