"""One kamikaze episode in numbers, as the search for the clairvoyant kamikaze needs it: φ, the car and its known noise.

The car's noise is known for every tick, so its state is a function of when it braked.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from skd_sim.compilation import kernel
from skd_sim.episode import Episode
from skd_sim.geometry import rectangle_distance
from skd_sim.motion import next_speed, travelled
from skd_sim.randomness import Role, generator
from skd_sim.world import make_world

FloatArray = npt.NDArray[np.float64]

SURE = 1.0 + 1e-9
"""Margin of what is left out for being too far."""
MARGIN = 1e-9  # m, the same for lengths that may be 0


class Course(NamedTuple):
    """One episode; lengths in m, speeds in m/s, times in s."""

    path: FloatArray  # φ, n × 2
    noise: FloatArray  # ticks × 2: relative perturbation of speed and of acceleration
    slowest: FloatArray  # ticks + 1: least share of its speed that a car keeps from tick t on, unbraked
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
    pedestrian_speed: float
    path_edge: float
    minimum_impact_speed: float


def make_course(episode: Episode) -> Course:
    """Return a kamikaze episode in numbers, the car's noise of every tick included."""
    scenario, world = episode.scenario, make_world(episode)
    car, walker, ticks = scenario.car, scenario.pedestrian, scenario.ticks
    assert episode.safe_trajectory is not None
    # The world draws two numbers a tick, for the speed and for the acceleration, whatever happens.
    draws = generator(episode.seed, episode.episode_id, Role.CAR).random((ticks, 2))
    noise = (2.0 * draws - 1.0) * np.array([car.speed_noise, car.acceleration_noise])
    slowest = np.ones(ticks + 1)
    for tick in range(ticks - 1, -1, -1):
        slowest[tick] = min(1.0, (1.0 + noise[tick, 0]) * slowest[tick + 1])
    return Course(
        path=np.array(episode.safe_trajectory.positions, order="C"),
        noise=noise,
        slowest=slowest,
        car_x=world.car.x,
        car_y=world.car.y,
        car_speed=world.car.speed,
        cos_heading=math.cos(world.car.heading),
        sin_heading=math.sin(world.car.heading),
        front=car.front,
        rear=car.rear,
        half_width=car.half_width,
        radius=walker.reach,
        trigger=episode.multiplier * car.safe_distance,
        deceleration=car.deceleration,
        time_step=scenario.time_step,
        pedestrian_speed=walker.speed,
        path_edge=scenario.path_edge,
        minimum_impact_speed=scenario.collision.minimum_impact_speed,
    )


@kernel
def car_step(c: Course, y: float, speed: float, braking: bool, tick: int) -> tuple[float, float]:
    """Return how far the car comes in a tick (m) and its speed after it (m/s)."""
    acceleration = -c.deceleration if braking else 0.0
    applied = acceleration + c.noise[tick, 1] * acceleration
    after = next_speed(speed, applied, c.noise[tick, 0], c.time_step)
    return travelled(speed, after, c.time_step), after


@kernel
def first_braking(c: Course, limit: float) -> int:
    """Return the first tick at which the car can brake for somebody within the (squared) limit of φ."""
    south = np.min(c.path[:, 1]) - SURE * np.sqrt(limit) - MARGIN
    y, speed = c.car_y, c.car_speed
    for tick in range(c.noise.shape[0]):
        if y + c.front + c.trigger >= south:
            return tick
        distance, speed = car_step(c, y, speed, False, tick)
        y += distance
    return c.noise.shape[0]  # type: ignore[no-any-return]


class Bands(NamedTuple):
    """Where the car must be when it is touched near enough to the end of φ; y in m."""

    front_low: float  # of its front
    front_high: float
    rear_low: float  # or of its rear, which only who is faster than the car can touch
    rear_high: float


@kernel
def contact_bands(c: Course, limit: float) -> Bands:
    """Return where the car must be for a contact within the (squared) limit of the end of φ.

    Nobody is touched but on the outline of the car grown by the pedestrian's radius, and, as nobody walks West, not on
    the East side of it: what is left there are the quarter circles about the two corners. A φ that ends East of the
    car's path has only them near.
    """
    x, y = c.path[-1, 0], c.path[-1, 1]
    near = SURE * np.sqrt(limit) + MARGIN
    off = max(0.0, abs(x) - c.path_edge - MARGIN)
    if near < off:
        return Bands(np.inf, -np.inf, np.inf, -np.inf)
    half = np.sqrt(near * near - off * off)
    at_start = rectangle_distance(c.path[0, 1] - c.car_y, c.path[0, 0] - c.car_x, c.front, c.rear, c.half_width)
    if (
        c.minimum_impact_speed > 0.0  # who is not counted as hit may be inside the outline
        or at_start <= c.radius + MARGIN
        or x < c.path_edge
        or near >= x + c.path_edge  # the West side of the car is near enough
    ):
        low, high = y - half - c.radius - MARGIN, y + half + c.front + c.rear + c.radius + MARGIN
        return Bands(low, high, np.inf, -np.inf)
    # The nearest point of a quarter circle is its East end, or lies on the line from the corner to the end of φ.
    across = x - c.half_width
    far = np.sqrt((near + c.radius) ** 2 - across * across)
    return Bands(y - far - MARGIN, y + half + MARGIN, y - half - MARGIN, y + far + MARGIN)


@kernel
def last_contact_tick(c: Course, bands: Bands, y: float, speed: float, tick: int, braking: int) -> int:
    """Return the last tick, numbered from 1, in which a car can be touched near enough to the end of φ.

    Whatever it does, it is never behind the car that brakes at every tick, nor ahead of the one that never does.

    Args:
        c: the episode.
        bands: where it is touched.
        y: of the car after `tick` ticks, m.
        speed: likewise, m/s.
        tick: how many ticks have gone.
        braking: first tick in which it can brake for anybody.

    Returns:
        The tick; 0 where there is none after `tick`.
    """
    last = 0
    y_free, speed_free = y, speed
    step = SURE * c.time_step * c.pedestrian_speed
    for now in range(tick, c.noise.shape[0]):
        ahead, speed_free = car_step(c, y_free, speed_free, False, now)
        y_free += ahead
        distance, speed = car_step(c, y, speed, now >= braking, now)
        if y + c.front <= bands.front_high and y_free + c.front >= bands.front_low:
            last = now + 1
        if y - c.rear <= bands.rear_high and y_free - c.rear >= bands.rear_low and distance <= step:
            last = now + 1
        y += distance
        if y + c.front > bands.front_high and y - c.rear > bands.rear_high:
            break
    return last
