"""The world with either car: the basic one as it always was, the multi-body one with contact anywhere in a tick."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.road import HEADING_NORTH
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.world.contact import first_contact, rectangle_distance, to_car_frame
from skd_sim.world.dynamics.basic import BasicCar, make_dynamics
from skd_sim.world.dynamics.multi_body_car import MultiBodyCar
from skd_sim.world.state import AdversaryState, CarState, draw_relative, next_speed, travelled
from skd_sim.world.world import World

BASIC = load_scenario("crossing")
MULTI_BODY = load_scenario("crossing_multi_body")


@kernel
def _paper_step(
    car: CarState,
    adversary: AdversaryState,
    acceleration: float,
    vx: float,
    vy: float,
    footprint: tuple[float, float, float, float],
    noise: tuple[float, float],
    time_step: float,
    rng: np.random.Generator,
) -> tuple[float, float, float, float, float, float]:
    """One step of the basic car and the adversary in one piece, as the world had it before cars could be chosen."""
    front, rear, half_width, radius = footprint
    speed_noise, acceleration_noise = noise
    speed_draw = draw_relative(speed_noise, rng)
    acceleration_draw = draw_relative(acceleration_noise, rng)
    applied = acceleration + acceleration_draw * acceleration
    speed = next_speed(car.speed, applied, speed_draw, time_step)
    distance = travelled(car.speed, speed, time_step)
    x = car.x + distance * math.cos(car.heading)
    y = car.y + distance * math.sin(car.heading)
    px = adversary.x + time_step * vx
    py = adversary.y + time_step * vy
    ahead, left = to_car_frame(adversary.x, adversary.y, car.x, car.y, car.heading)
    ahead_after, left_after = to_car_frame(px, py, x, y, car.heading)
    contact = first_contact(ahead, left, ahead_after, left_after, front, rear, half_width, radius)
    return x, y, speed, px, py, contact


def test_basic_car_keeps_its_bits() -> None:
    car, radius = BASIC.car, BASIC.adversary.radius
    footprint = (car.front, car.rear, car.half_width, radius)
    contacts = 0
    for seed in range(60):
        start = np.random.default_rng([seed, 0])
        commands = np.random.default_rng([seed, 2])
        world = World(BASIC, start_rng=np.random.default_rng([seed, 0]), car_rng=np.random.default_rng([seed, 1]))
        rng = np.random.default_rng([seed, 1])
        gap = car.start_gap + car.start_gap_range * start.random()
        state = CarState(0.0, -gap - car.front, HEADING_NORTH, car.start_speed)
        adversary = AdversaryState(BASIC.adversary.start_x, BASIC.adversary.start_y, 0.0, 0.0)
        for _ in range(12):
            acceleration, vx, vy = commands.uniform(-4.0, 1.0), commands.uniform(0.0, 2.5), commands.uniform(-1.0, 1.0)
            contact = world.step(acceleration, (vx, vy))
            x, y, speed, px, py, fraction = _paper_step(
                state, adversary, acceleration, vx, vy, footprint, (car.speed_noise, car.acceleration_noise), 0.3, rng
            )
            impact = state.speed + fraction * (speed - state.speed)
            assert contact == ((fraction, impact) if fraction <= 1.0 else None)
            state, adversary = CarState(x, y, HEADING_NORTH, speed), AdversaryState(px, py, vx, vy)
            assert world.car == state
            assert world.adversary == adversary
            contacts += contact is not None
    assert contacts > 20


def test_the_scenario_chooses_the_car() -> None:
    assert isinstance(make_dynamics(BASIC), BasicCar)
    assert isinstance(make_dynamics(MULTI_BODY), MultiBodyCar)


def _quiet(**changes: object) -> Scenario:
    return replace(MULTI_BODY, car=replace(MULTI_BODY.car, acceleration_noise=0.0, start_gap_range=0.0, **changes))


def _world(scenario: Scenario, gap: float, start: tuple[float, float]) -> World:
    rng = np.random.default_rng(0)
    return World(scenario, adversary_start=start, gap=gap, start_rng=rng, car_rng=np.random.default_rng(1))


@pytest.mark.parametrize("gap", np.linspace(0.4, 2.0, 9))
def test_impact_of_a_braking_car_on_one_who_stands(gap: float) -> None:
    """Where the front has come within the radius, at the speed the car has there: read off a car driven by 1 ms."""
    scenario = _quiet(brake_delay=0.0)
    car = MultiBodyCar(replace(scenario, time_step=0.001))
    car.reset(CarState(0.0, 0.0, HEADING_NORTH, scenario.car.start_speed))
    way, speed = [0.0], [scenario.car.start_speed]
    for _ in range(300):
        *_, (_, y, _, v) = car.advance(-15.0, 0.001, car.draw(np.random.default_rng(0))).tolist()
        way.append(y)
        speed.append(v)
    distance = gap - scenario.adversary.radius
    contact = _world(scenario, gap, (0.0, 0.0)).step(-15.0, (0.0, 0.0))
    if distance >= way[-1]:
        assert contact is None
        return
    assert contact is not None
    time = np.interp(distance, way, np.linspace(0.0, 0.3, 301))
    assert contact.fraction == pytest.approx(time / 0.3, abs=1e-3)
    assert contact.speed == pytest.approx(np.interp(time, np.linspace(0.0, 0.3, 301), speed), abs=0.01)


def test_the_braking_car_is_hit_where_a_uniform_tick_would_miss() -> None:
    """Contact within the tick, none at its ends: compare with brute force over positions 0.1 ms apart."""
    scenario = _quiet()
    radius, rng = scenario.adversary.radius, np.random.default_rng(3)
    found = {True: 0, False: 0}
    for _ in range(200):
        start = (rng.uniform(-1.6, -0.9), rng.uniform(-0.3, 0.6))
        velocity = (rng.uniform(-1.0, 2.5), rng.uniform(-2.5, 2.5))
        gap = rng.uniform(-0.5, 2.5)
        world = _world(scenario, gap, start)
        ahead, left = to_car_frame(*start, 0.0, world.car.y, HEADING_NORTH)
        car = scenario.car
        if rectangle_distance(ahead, left, car.front, car.rear, car.half_width) <= radius:
            continue
        fine = MultiBodyCar(scenario)
        fine.reset(world.car)
        path = fine.advance(-15.0, 0.3, fine.draw(np.random.default_rng(1)))
        times = np.linspace(0.0, 1.0, 3001)
        ys = np.interp(times, np.linspace(0.0, 1.0, len(path)), path[:, 1])
        distances = []
        for s, y in zip(times, ys, strict=True):
            ahead, left = to_car_frame(
                start[0] + 0.3 * s * velocity[0], start[1] + 0.3 * s * velocity[1], 0.0, y, HEADING_NORTH
            )
            distances.append(rectangle_distance(ahead, left, car.front, car.rear, car.half_width))
        nearest = min(distances)
        if abs(nearest - radius) < 1e-3:
            continue  # too close to call for brute force
        contact = world.step(-15.0, velocity)
        assert (contact is not None) == (nearest < radius)
        found[contact is not None] += 1
        if contact is not None:
            first = times[int(np.argmax(np.array(distances) <= radius))]
            assert contact.fraction == pytest.approx(first, abs=1e-3)
    assert min(found.values()) > 20


def test_slow_impacts_do_not_count() -> None:
    scenario = replace(_quiet(), collision=replace(MULTI_BODY.collision, minimum_impact_speed=8.0))
    assert _world(scenario, 0.5, (0.0, 0.0)).step(0.0, (0.0, 0.0)) is not None
    scenario = replace(scenario, collision=replace(MULTI_BODY.collision, minimum_impact_speed=9.0))
    assert _world(scenario, 0.5, (0.0, 0.0)).step(0.0, (0.0, 0.0)) is None


def test_same_seed_same_bits() -> None:
    def drive(seed: int) -> list[CarState]:
        world = World(MULTI_BODY, start_rng=np.random.default_rng(seed), car_rng=np.random.default_rng([seed, 1]))
        states = [world.car]
        for tick in range(10):
            world.step(-3.5 if tick > 3 else 0.0, (0.0, 0.0))
            states.append(world.car)
        return states

    assert drive(4) == drive(4)
    assert drive(4) != drive(5)
