"""Where and when the car can be touched near enough to the end of φ, which a Fréchet distance always has to come to."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from skd_sim.geometry.contact import rectangle_distance
from skd_sim.kernels.compilation import kernel

from skd_evaluator.margin.exact.course import MARGIN, SURE, Course, car_step


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

    Nobody is touched but on the outline of the car grown by the adversary's radius, and, as nobody walks West, not on
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
        c: what is known of the episode beforehand.
        bands: the places, tick by tick, where the car can be touched.
        y: place of the car along the lane after `tick` ticks, m.
        speed: the car's speed after `tick` ticks, m/s.
        tick: how many ticks have gone.
        braking: first tick in which it can brake for anybody.

    Returns:
        The tick; 0 where there is none after `tick`.
    """
    last = 0
    y_free, speed_free = y, speed
    step = SURE * c.time_step * c.adversary_speed
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
