"""The world: contacts and noise, curved roads, limits of commands, and cars that decide between ticks."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from shapely import affinity
from skd_sim import AdversaryState, CarState, EpisodeSpec, Mode, Scenario, load_scenario
from skd_sim.scenario.road import Part, Road, road_pose, road_position
from skd_sim.world.dynamics.basic import GRIP, command_limits
from skd_sim.world.episode import Role, generator, period_of, period_stamp, tick_stamp
from skd_sim.world.world import World, make_world

CROSSING = load_scenario("crossing")
STEP = CROSSING.time_step


@pytest.mark.parametrize("acceleration", [0.0, -3.5, 2.0])
def test_impact_in_closed_form(acceleration: float) -> None:
    """A standing adversary is hit where the front has come within the radius."""
    quiet = {"speed_noise": 0.0, "acceleration_noise": 0.0, "start_gap_range": 0.0}
    scenario, gap = car(CROSSING, **quiet), 1.5
    world = make(scenario, adversary_start=(0.0, 0.0), gap=gap)
    before = world.car.speed
    contact = world.step(acceleration, (0.0, 0.0))
    after = before + STEP * acceleration
    way = 0.5 * STEP * (before + after)
    fraction = (gap - scenario.adversary.radius) / way
    assert contact.fraction == pytest.approx(fraction, rel=1e-12)
    assert contact.speed == pytest.approx(before + fraction * (after - before), rel=1e-12)
    assert world.car.y == pytest.approx(-gap - scenario.car.front + way)


@pytest.mark.parametrize("acceleration", [0.0, -3.5])
def test_speed_after_one_step_has_the_moments_of_the_paper(acceleration: float) -> None:
    """ν' = ν + U[−0.05 ν, 0.05 ν] + Δt (a + U[−0.1 a, 0.1 a]): mean ν + Δt a, variance the sum of both."""
    n = 20_000
    speed = CROSSING.car.start_speed
    rng = np.random.default_rng(5)
    speeds = np.empty(n)
    for i in range(n):
        world = World(CROSSING, gap=100.0, start_rng=rng, car_rng=rng)
        world.step(acceleration, (0.0, 0.0))
        speeds[i] = world.car.speed
    a, b = 0.05 * speed, 0.1 * abs(acceleration) * STEP
    variance = (a**2 + b**2) / 3.0
    assert abs(speeds.mean() - speed - STEP * acceleration) < 4.0 * math.sqrt(variance / n)
    fourth = a**4 / 5.0 + b**4 / 5.0 + 6.0 * (a**2 / 3.0) * (b**2 / 3.0)
    assert abs(speeds.var() - variance) < 4.0 * math.sqrt((fourth - variance**2) / n)
    assert np.abs(speeds - speed - STEP * acceleration).max() <= a + b


MULTI_BODY = load_scenario("crossing_multi_body")


def car(scenario: Scenario, **changes: float) -> Scenario:
    return replace(scenario, car=replace(scenario.car, **changes))


def world(scenario: Scenario) -> World:
    return World(scenario, start_rng=np.random.default_rng(1), car_rng=np.random.default_rng(2))


def test_limits_by_hand() -> None:
    assert pytest.approx(11.5, abs=0.05) == GRIP  # a friction coefficient of 1.17, as of a good tyre on a dry road
    assert command_limits(CROSSING) == (-GRIP, GRIP)
    assert command_limits(car(CROSSING, brake_limit=6.0)).least == -6.0
    assert command_limits(car(CROSSING, brake_limit=2.0)).least == -3.5  # what the scenario says that this car can do
    assert command_limits(car(CROSSING, deceleration=15.0)).least == -15.0
    assert command_limits(MULTI_BODY) == (-15.0, GRIP)  # its own tyres do the rest
    wet = replace(MULTI_BODY, road=replace(MULTI_BODY.road, friction=0.5))
    assert command_limits(wet).greatest == 0.5 * GRIP


@pytest.mark.parametrize("scenario", [CROSSING, MULTI_BODY], ids=["basic", "multi-body"])
def test_a_command_beyond_is_the_limit_and_is_counted(scenario: Scenario) -> None:
    limits = command_limits(scenario)
    for beyond, limit in ((-200.0, limits.least), (1e300, limits.greatest)):
        one, other = world(scenario), world(scenario)
        one.step(beyond, (0.0, 0.0))
        other.step(limit, (0.0, 0.0))
        assert one.car == other.car
        assert (one.clipped, other.clipped) == (1, 0)
        one.step(limit, (0.0, 0.0))
        assert one.clipped == 1


def clocked(scenario: Scenario, periods: int) -> Scenario:
    return replace(scenario, control_period=scenario.time_step / periods)


def world_of(scenario: Scenario, seed: int = 3) -> World:
    return make_world(EpisodeSpec(scenario, Mode.SAFE, seed, 1))


@pytest.mark.parametrize("periods", [2, 3, 6, 30])
def test_noise_is_drawn_once_a_tick_and_spread_evenly(periods: int) -> None:
    """By hand: the same two numbers a tick, a share of the first and all of the second in every control period."""
    scenario = clocked(CROSSING, periods)
    world = world_of(scenario)
    rng = generator(3, 1, Role.CAR)
    y, speed = world.car.y, world.car.speed
    for tick in range(10):
        acceleration = -3.5 if tick > 4 else 1.0
        by_speed, by_acceleration = 0.05 * (2.0 * rng.random() - 1.0), 0.1 * (2.0 * rng.random() - 1.0)
        for _ in range(periods):
            before = speed
            speed += by_speed / periods * speed + STEP / periods * acceleration * (1.0 + by_acceleration)
            y += 0.5 * STEP / periods * (before + max(0.0, speed))
            speed = max(0.0, speed)
            world.step(acceleration, (0.0, 0.0))
        assert (world.tick, world.period) == (tick + 1, 0)
        assert (world.car.y, world.car.speed) == pytest.approx((y, speed), abs=1e-9)


@given(periods=st.integers(1, 12), velocity=st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)))
def test_adversaries_move_uniformly_between_ticks(periods: int, velocity: tuple[float, float]) -> None:
    world = world_of(clocked(CROSSING, periods))
    start = world.adversary
    for period in range(1, periods + 1):
        world.step(0.0, velocity)
        share = STEP * period / periods
        here = (start.x + share * velocity[0], start.y + share * velocity[1], *velocity, 0.0)
        assert world.adversary == pytest.approx(here, abs=1e-12)
        assert world.tick * periods + world.period == period
    assert world.adversary == AdversaryState(start.x + STEP * velocity[0], start.y + STEP * velocity[1], *velocity)


@given(
    start=st.integers(0, 10**15),
    tick=st.integers(0, 2000),
    period=st.integers(0, 59),
    periods=st.integers(1, 60),
    time_step=st.floats(0.05, 2.0),
)
def test_stamps_say_which_tick_and_period_it_is(start, tick, period, periods, time_step):
    period %= periods
    stamp = period_stamp(start, tick, period, periods, time_step)
    assert period_of(stamp, start, time_step, periods) == (tick, period)
    assert period_of(stamp + 1, start, time_step, periods) is None
    assert (stamp == tick_stamp(start, tick, time_step)) == (period == 0)
    if period:
        assert period_of(stamp, start, time_step) is None  # of who knows only ticks
    assert period_of(start - 1 - stamp + start, start, time_step, periods) is None


TURN = Road(3.5, parts=(Part(40.0), Part(4.0 * math.pi, 8.0, "right"), Part(40.0)), origin=48.0)
BOX = replace(CROSSING.adversary, radius=None, length=1.8, width=0.6, kind="cyclist")


def make(scenario: Scenario, *, seed: int = 0, **changes: Any) -> World:
    streams = np.random.SeedSequence(seed).spawn(2)
    start, car = (np.random.default_rng(stream) for stream in streams)
    return World(scenario, start_rng=start, car_rng=car, **changes)


def test_on_a_curve_the_car_drives_as_far_and_as_fast_as_on_the_straight_road() -> None:
    straight, curved = make(CROSSING), make(replace(CROSSING, road=TURN))
    for tick in range(12):
        command = -3.5 if 4 <= tick < 6 else 0.0
        straight.step(command, (0.0, 0.0))
        curved.step(command, (0.0, 0.0))
        assert curved.car.speed == straight.car.speed
        s, left = road_position(TURN.line, curved.car.x, curved.car.y)
        assert (s, left) == pytest.approx((straight.car.y, 0.0), abs=1e-9)
        heading = road_pose(TURN.line, s)[2]
        assert math.remainder(curved.car.heading - heading, math.tau) == pytest.approx(0.0, abs=1e-8)


def polygon(car: CarState, scenario: Scenario) -> shapely.Polygon:
    size = scenario.car
    box = shapely.box(-size.rear, -size.half_width, size.front, size.half_width)
    turned = affinity.rotate(box, car.heading, origin=(0, 0), use_radians=True)
    return affinity.translate(turned, car.x, car.y)


def body(scenario: Scenario, x: float, y: float, velocity: tuple[float, float]) -> Any:
    half_length, half_width = scenario.adversary.shape[1:]
    box = shapely.box(-half_length, -half_width, half_length, half_width)
    turned = affinity.rotate(box, math.atan2(velocity[1], velocity[0]), origin=(0, 0), use_radians=True)
    return affinity.translate(turned, x, y)


def test_first_contact_of_a_box_on_a_curve_against_polygons() -> None:
    """At 400 moments of a tick, the car at its true pose on the arc; discs are in test_risk_comparison.py."""
    scenario = replace(CROSSING, road=TURN, adversary=BOX)
    quiet = replace(scenario, car=replace(scenario.car, speed_noise=0.0, acceleration_noise=0.0, start_gap_range=0.0))
    rng = np.random.default_rng(5)
    touched = 0
    for _ in range(40):
        gap = float(rng.uniform(0.0, 12.0))
        s = -gap - quiet.car.front
        speed = quiet.car.start_speed
        x, y, _ = road_pose(TURN.line, s + 3.0)
        place = (x + float(rng.uniform(-4.0, 4.0)), y + float(rng.uniform(-4.0, 4.0)))
        angle = float(rng.uniform(-math.pi, math.pi))
        velocity = (2.5 * math.cos(angle), 2.5 * math.sin(angle))
        distances = []
        for share in np.linspace(0.0, 1.0, 401):
            moved = (place[0] + STEP * share * velocity[0], place[1] + STEP * share * velocity[1])
            car = CarState(*road_pose(TURN.line, s + share * STEP * speed), speed)
            distances.append(polygon(car, quiet).distance(body(quiet, *moved, velocity)))
        if 0.0 < min(distances) < 2e-3:
            continue  # a graze, for which neither is exact enough
        contact = make(quiet, adversary_start=place, gap=gap).step(0.0, velocity)
        first = np.flatnonzero(np.array(distances) <= 0.0)
        assert (contact is not None) == (len(first) > 0)
        if contact is not None:
            assert contact.fraction == pytest.approx(first[0] / 400.0, abs=4e-3)
            touched += 1
    assert 5 <= touched <= 35  # both happen
