"""A car that decides more often than the adversary: the world between ticks, its noise, its contacts and its stamps."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.world.episode import EpisodeSpec, Mode, Role, generator
from skd_sim.world.state import AdversaryState
from skd_sim.world.timing import period_of, period_stamp, tick_stamp
from skd_sim.world.world import World, make_world

CROSSING = load_scenario("crossing")
STEP = CROSSING.time_step


def clocked(scenario: Scenario, periods: int) -> Scenario:
    return replace(scenario, control_period=scenario.time_step / periods)


def world_of(scenario: Scenario, seed: int = 3) -> World:
    return make_world(EpisodeSpec(scenario, Mode.SAFE, seed, 1))


# --- noise


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


# --- the adversary, and contacts


@given(
    periods=st.integers(1, 12),
    velocity=st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)),
)
def test_adversaries_move_uniformly_between_ticks(periods: int, velocity: tuple[float, float]) -> None:
    world = world_of(clocked(CROSSING, periods))
    start = world.adversary
    for period in range(1, periods + 1):
        world.step(0.0, velocity)
        share = STEP * period / periods
        here = (start.x + share * velocity[0], start.y + share * velocity[1], *velocity, 0.0)
        assert world.adversary == pytest.approx(here, abs=1e-12)
        assert world.time == pytest.approx(share)
    assert world.adversary == AdversaryState(start.x + STEP * velocity[0], start.y + STEP * velocity[1], *velocity)


# --- scans and stamps


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
