"""The world with either car: the basic one as it always was, the multi-body one with contact anywhere in a tick."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from skd_sim.scenario.road import HEADING_NORTH
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.world.contact import rectangle_distance, to_car_frame
from skd_sim.world.dynamics.multi_body import MultiBodyCar
from skd_sim.world.world import World

MULTI_BODY = load_scenario("crossing_multi_body")


def _quiet(**changes: object) -> Scenario:
    return replace(MULTI_BODY, car=replace(MULTI_BODY.car, acceleration_noise=0.0, start_gap_range=0.0, **changes))


def _world(scenario: Scenario, gap: float, start: tuple[float, float]) -> World:
    rng = np.random.default_rng(0)
    return World(scenario, adversary_start=start, gap=gap, start_rng=rng, car_rng=np.random.default_rng(1))


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
