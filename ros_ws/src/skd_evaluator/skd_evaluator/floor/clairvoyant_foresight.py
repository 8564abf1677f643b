"""What the car can do while the pedestrian stays within a limit of φ, and how near to φ it can still touch him.

The car knows of the pedestrian only whether it brakes, so its states form a tree: two branches a tick. Braking or not
braking asks for a place, ahead or not, that is some way from φ, and so does being touched. The least of these ways,
over all that is still to come, bounds from below what any sequence of actions will have strayed at its contact.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from skd_sim.compilation import kernel
from skd_sim.geometry import rectangle_distance

from skd_evaluator.floor.clairvoyant_course import MARGIN, SURE, Course, car_step

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

UNKNOWN, NEVER = -1, -2
"""Of a child: not made yet, or of no use within the limit."""


class Foresight(NamedTuple):
    """Memory for the car's states, in the order of their ticks as far as they are made ahead of the search."""

    size: IntArray  # [states, those of them that have all their branches]
    car: FloatArray  # id → x, y, m, and speed, m/s
    tick: IntArray  # id → how many ticks have gone
    child: IntArray  # id × (free, braking) → id at the next tick, UNKNOWN or NEVER
    least: FloatArray  # id → m that a sequence still has to stray, at least; infinity: more than the limit


def make_foresight(capacity: int) -> Foresight:
    """Return memory for this many states of the car."""
    return Foresight(
        size=np.zeros(2, np.int64),
        car=np.empty((capacity, 3)),
        tick=np.empty(capacity, np.int64),
        child=np.empty((capacity, 2), np.int64),
        least=np.empty(capacity),
    )


@kernel(inline=True)
def place_of_phi(c: Course, tick: int) -> tuple[float, float]:
    """Return where φ is after `tick` ticks, m."""
    row = min(tick, c.path.shape[0] - 1)
    return c.path[row, 0], c.path[row, 1]


@kernel
def reach(c: Course) -> FloatArray:
    """Return how far one can be from φ after 0, 1, … ticks, m."""
    out = np.zeros(c.noise.shape[0] + 1)
    for tick in range(c.noise.shape[0]):
        x, y = place_of_phi(c, tick)
        x_to, y_to = place_of_phi(c, tick + 1)
        own = np.sqrt((x_to - x) ** 2 + (y_to - y) ** 2)
        out[tick + 1] = out[tick] + SURE * (own + c.time_step * c.pedestrian_speed) + MARGIN
    return out


@kernel
def braking_cost(c: Course, y: float, tick: int, braking: int) -> float:
    """Return how far from φ, at least, one makes a car at y brake after `tick` ticks, or lets it drive, m."""
    distance = place_of_phi(c, tick)[1] - y - c.front
    if braking:
        return max(0.0, -distance, distance - c.trigger)
    return max(0.0, min(distance, c.trigger - distance))


@kernel
def _segment_to_point(x: float, y: float, dx: float, dy: float, px: float, py: float) -> float:
    """Return the distance of a point from the points (x, y) + s·(dx, dy), 0 ≤ s ≤ 1."""
    length = dx * dx + dy * dy
    s = 0.0
    if length > 0.0:
        s = min(1.0, max(0.0, ((px - x) * dx + (py - y) * dy) / length))
    return np.sqrt((x + s * dx - px) ** 2 + (y + s * dy - py) ** 2)  # type: ignore[no-any-return]


@kernel
def _segment_to_rectangle(c: Course, ahead: float, left: float, ahead_to: float, left_to: float) -> float:
    """Return the distance from a way in the car's frame to the footprint, m."""
    da, dl = ahead_to - ahead, left_to - left
    low, high = 0.0, 1.0  # the part of the way that is in the rectangle
    for start, delta, least, most in ((ahead, da, -c.rear, c.front), (left, dl, -c.half_width, c.half_width)):
        if delta == 0.0:
            if not least <= start <= most:
                high = -1.0
        else:
            one, other = (least - start) / delta, (most - start) / delta
            low, high = max(low, min(one, other)), min(high, max(one, other))
    if low <= high:
        return 0.0
    distance = min(
        rectangle_distance(ahead, left, c.front, c.rear, c.half_width),
        rectangle_distance(ahead_to, left_to, c.front, c.rear, c.half_width),
    )
    for corner_ahead in (c.front, -c.rear):
        for corner_left in (c.half_width, -c.half_width):
            distance = min(distance, _segment_to_point(ahead, left, da, dl, corner_ahead, corner_left))
    return distance


@kernel
def _in_frame(c: Course, x: float, y: float, car: FloatArray) -> tuple[float, float]:
    dx, dy = x - car[0], y - car[1]
    return c.cos_heading * dx + c.sin_heading * dy, c.cos_heading * dy - c.sin_heading * dx


@kernel
def contact_cost(c: Course, before: FloatArray, after: FloatArray, tick: int) -> float:
    """Return how far from φ, at least, one is touched by the car in the tick after `tick` ticks, m."""
    x, y = place_of_phi(c, tick)
    x_to, y_to = place_of_phi(c, tick + 1)
    ahead, left = _in_frame(c, x, y, before)
    ahead_to, left_to = _in_frame(c, x_to, y_to, after)
    return max(0.0, _segment_to_rectangle(c, ahead, left, ahead_to, left_to) - c.radius)


@kernel
def next_state(c: Course, f: Foresight, state: int, braking: int) -> int:
    """Return the state of the car one tick on, made where it is not known yet; −1: no room.

    A car that stands does so whether it brakes or not.
    """
    known = f.child[state, braking]
    if known < 0 and f.car[state, 2] == 0.0:
        known = f.child[state, 1 - braking]
        f.child[state, braking] = known
    if known >= 0:
        return known  # type: ignore[no-any-return]
    new = f.size[0]
    if new >= f.car.shape[0]:
        return -1
    f.size[0] = new + 1
    tick = f.tick[state]
    distance, speed = car_step(c, f.car[state, 1], f.car[state, 2], braking != 0, tick)
    f.car[new, 0] = f.car[state, 0] + distance * c.cos_heading
    f.car[new, 1] = f.car[state, 1] + distance * c.sin_heading
    f.car[new, 2] = speed
    f.tick[new] = tick + 1
    f.child[new, :] = UNKNOWN
    f.least[new] = 0.0
    f.child[state, braking] = new
    return new  # type: ignore[no-any-return]


@kernel
def foresee(c: Course, f: Foresight, limit: float, most: int) -> None:
    """Make the states that the car can come to while the pedestrian is within the limit of φ, and their `least`.

    Args:
        c: the episode.
        f: memory; what was in it is forgotten.
        limit: m.
        most: how many states may be made; those beyond are left to the search, with a `least` of 0.
    """
    ticks = c.noise.shape[0]
    reachable = reach(c)
    north = np.empty(ticks + 1)  # the farthest North that φ will be
    highest = -np.inf
    for tick in range(ticks, -1, -1):
        highest = max(highest, place_of_phi(c, tick)[1])
        north[tick] = highest
    f.size[0] = 1
    f.car[0, 0], f.car[0, 1], f.car[0, 2] = c.car_x, c.car_y, c.car_speed
    f.tick[0] = 0
    f.child[0, :] = UNKNOWN
    begin, full = 0, False
    while begin < f.size[0] and f.tick[begin] < ticks and not full:
        end = f.size[0]
        if end + 2 * (end - begin) > most:
            full = True
            break
        for state in range(begin, end):
            tick, y = f.tick[state], f.car[state, 1]
            allowed = min(limit, reachable[tick]) + MARGIN
            passed = y - c.rear - c.radius > north[tick] + SURE * limit + MARGIN
            for braking in range(2):
                if passed or braking_cost(c, y, tick, braking) > allowed:
                    f.child[state, braking] = NEVER
                else:
                    next_state(c, f, state, braking)
        begin = end
    f.size[1] = begin if full else f.size[0]
    for state in range(f.size[0] - 1, -1, -1):
        tick = f.tick[state]
        if state >= f.size[1]:
            f.least[state] = 0.0
            continue
        f.least[state] = np.inf
        for braking in range(2):
            child = f.child[state, braking]
            if child < 0:
                continue
            contact = contact_cost(c, f.car[state], f.car[child], tick)
            if contact > reachable[tick + 1] + MARGIN:
                contact = np.inf
            still = max(braking_cost(c, f.car[state, 1], tick, braking), min(contact, f.least[child])) - MARGIN
            if still <= limit:
                f.least[state] = min(f.least[state], max(0.0, still))
