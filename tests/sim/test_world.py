from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.world.world import World

CROSSING = load_scenario("crossing")
STEP = CROSSING.time_step


def _scenario(*, minimum_impact_speed: float = 0.0, start_gap_range: float = 0.0) -> Scenario:
    """The crossing without noise."""
    car = replace(CROSSING.car, speed_noise=0.0, acceleration_noise=0.0, start_gap_range=start_gap_range)
    collision = replace(CROSSING.collision, minimum_impact_speed=minimum_impact_speed)
    return replace(CROSSING, car=car, collision=collision)


def _world(scenario: Scenario, gap: float, start: tuple[float, float] = (0.0, 0.0), seed: int = 0) -> World:
    return World(
        scenario,
        adversary_start=start,
        gap=gap,
        start_rng=np.random.default_rng([seed, 0]),
        car_rng=np.random.default_rng([seed, 1]),
    )


@pytest.mark.parametrize("acceleration", [0.0, -3.5, 2.0])
def test_impact_in_closed_form(acceleration: float) -> None:
    """A standing adversary is hit where the front has come within the radius."""
    scenario = _scenario()
    gap = 1.5
    world = _world(scenario, gap)
    before = world.car.speed
    contact = world.step(acceleration, (0.0, 0.0))
    assert contact is not None
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
