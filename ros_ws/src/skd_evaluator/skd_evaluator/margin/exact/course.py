"""One kamikaze episode of the basic car in numbers: φ, the car and its known noise.

The car's noise is known for every tick, so its state is a function of when it braked.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel
from skd_sim.world.episode import Episode, Role, generator
from skd_sim.world.state import next_speed, travelled
from skd_sim.world.world import make_world

from skd_evaluator.margin.actions import WAY_COUNT

SURE = 1.0 + 1e-9
"""Margin of what is left out for being too far."""
MARGIN = 1e-9  # m, the same for lengths that may be 0


class Course(NamedTuple):
    """One episode; lengths in m, speeds in m/s, times in s."""

    path: FloatArray  # φ, n × 2
    noise: FloatArray  # ticks × 2: relative perturbation of speed and of acceleration
    slowest: FloatArray  # ticks + 1: least share of its speed that a car keeps from tick t on, unbraked
    fastest: FloatArray  # ticks + 1: greatest share of its speed that a car has at any time from tick t on
    car_x: float
    car_y: float
    car_speed: float
    cos_heading: float
    sin_heading: float
    front: float
    rear: float
    half_width: float
    radius: float
    trigger: float
    deceleration: float
    time_step: float
    adversary_speed: float
    path_edge: float
    minimum_impact_speed: float
    hit_speed: float
    ways: int  # how many of the ways of `margin.actions` are searched: the first ones


def make_course(episode: Episode, ways: int = WAY_COUNT) -> Course:
    """Return a kamikaze episode in numbers, the car's noise of every tick included."""
    scenario, world = episode.scenario, make_world(episode)
    car, adversary, ticks = scenario.car, scenario.adversary, scenario.ticks
    assert episode.safe_trajectory is not None
    # The world draws two numbers a tick, for the speed and for the acceleration, whatever happens.
    draws = generator(episode.seed, episode.episode_id, Role.CAR).random((ticks, 2))
    noise = (2.0 * draws - 1.0) * np.array([car.speed_noise, car.acceleration_noise])
    slowest, fastest = np.ones(ticks + 1), np.ones(ticks + 1)
    for tick in range(ticks - 1, -1, -1):
        slowest[tick] = min(1.0, (1.0 + noise[tick, 0]) * slowest[tick + 1])
        fastest[tick] = max(1.0, (1.0 + noise[tick, 0]) * fastest[tick + 1])
    return Course(
        path=np.array(episode.safe_trajectory.positions, order="C"),
        noise=noise,
        slowest=slowest,
        fastest=fastest,
        car_x=world.car.x,
        car_y=world.car.y,
        car_speed=world.car.speed,
        cos_heading=math.cos(world.car.heading),
        sin_heading=math.sin(world.car.heading),
        front=car.front,
        rear=car.rear,
        half_width=car.half_width,
        radius=adversary.reach,
        trigger=episode.multiplier * car.safe_distance,
        deceleration=car.deceleration,
        time_step=scenario.time_step,
        adversary_speed=adversary.speed,
        path_edge=scenario.path_edge,
        minimum_impact_speed=scenario.collision.minimum_impact_speed,
        hit_speed=max(scenario.collision.hit_speed, scenario.collision.minimum_impact_speed),
        ways=ways,
    )


@kernel
def car_step(c: Course, y: float, speed: float, braking: bool, tick: int) -> tuple[float, float]:
    """Return how far the car comes in a tick (m) and its speed after it (m/s)."""
    acceleration = -c.deceleration if braking else 0.0
    applied = acceleration + c.noise[tick, 1] * acceleration
    after = next_speed(speed, applied, c.noise[tick, 0], c.time_step)
    return travelled(speed, after, c.time_step), after


@kernel(inline=True)
def place_of_phi(c: Course, tick: int) -> tuple[float, float]:
    """Return where φ is after `tick` ticks, m."""
    row = min(tick, c.path.shape[0] - 1)
    return c.path[row, 0], c.path[row, 1]
