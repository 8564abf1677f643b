"""A chart of what a pedestrian who is off φ by so much, beside a car in such a state, still has to stray at least.

Offsets from φ, up to a limit, are divided into square cells. Backwards from the last tick, each cell gets the least
cost of any sequence from any offset in it: of the cells that an action leads into, partly or altogether, the best one
counts, and a contact counts that somebody in the cell may have. So the chart is never above the truth. Every step of a
recorded φ is another, which lets sequences come to millions of places; the chart leaves out nearly all of them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from skd_adversary.model.road_user.pedestrian import ACTION_COUNT, AS_PHI, action_velocity
from skd_adversary.model.safe_path import path_velocity
from skd_sim.compilation import kernel
from skd_sim.geometry import first_contact

from skd_evaluator.floor.clairvoyant_course import MARGIN, SURE, Course
from skd_evaluator.floor.clairvoyant_foresight import Foresight, contact_cost, place_of_phi, reach

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
CostArray = npt.NDArray[np.float32]

_SAME = 1e-12  # m, between displacements that are one
_MOST, _FEWEST = 1 << 19, 8  # cells altogether; cells along an axis
_BELOW = np.float32(1.0 - 2.0**-22)  # what is stored in single precision is not above what was meant


class Chart(NamedTuple):
    """Least costs of cells."""

    row: IntArray  # state of the car → row of `least`; −1: more than the limit everywhere
    least: CostArray  # row × cell along x × cell along y → m; infinity: more than the limit
    low: float  # least offset along either axis, m
    cell: float  # side of a cell, m


@kernel
def _nearest(low: float, high: float) -> float:
    """Return the least |value| of an interval."""
    return max(0.0, low, -high)


@kernel
def _contact_bound(
    c: Course,
    before: FloatArray,
    after: FloatArray,
    ex: float,
    ey: float,
    vx: float,
    vy: float,
    tick: int,
    slack: float,
) -> float:
    """Return how far, at least, somebody is off φ who is touched in a tick that he begins within `slack` of an offset.

    Infinity where nobody is touched.
    """
    x, y = place_of_phi(c, tick)
    x_to, y_to = x + ex + c.time_step * vx, y + ey + c.time_step * vy
    dx, dy = x + ex - before[0], y + ey - before[1]
    ahead, left = c.cos_heading * dx + c.sin_heading * dy, c.cos_heading * dy - c.sin_heading * dx
    dx, dy = x_to - after[0], y_to - after[1]
    ahead_to, left_to = c.cos_heading * dx + c.sin_heading * dy, c.cos_heading * dy - c.sin_heading * dx
    radius = c.radius + slack
    side = c.half_width + radius
    if (
        min(left, left_to) > side
        or max(left, left_to) < -side
        or min(ahead, ahead_to) > c.front + radius
        or max(ahead, ahead_to) < -c.rear - radius
    ):
        return np.inf
    if first_contact(ahead, left, ahead_to, left_to, c.front, c.rear, c.half_width, radius) > 1.0:
        return np.inf
    # The way of the offset in this tick, and how near it comes to φ.
    x_phi_to, y_phi_to = place_of_phi(c, tick + 1)
    ox, oy = x_to - x_phi_to - ex, y_to - y_phi_to - ey
    length = ox * ox + oy * oy
    s = min(1.0, max(0.0, -(ex * ox + ey * oy) / length)) if length > 0.0 else 0.0
    return max(0.0, math.sqrt((ex + s * ox) ** 2 + (ey + s * oy) ** 2) - slack)


@kernel
def _best_next(least: CostArray, i: int, j: int, first: IntArray, last: IntArray, enough: float) -> float:
    """Return the least cost of the cells that actions lead into from cell (i, j), or one that is low enough."""
    best = np.inf
    cells = least.shape[0]
    for action in range(ACTION_COUNT, -1, -1):  # as φ first
        for ii in range(max(0, i + first[action, 0]), min(cells - 1, i + last[action, 0]) + 1):
            for jj in range(max(0, j + first[action, 1]), min(cells - 1, j + last[action, 1]) + 1):
                best = min(best, float(least[ii, jj]))
        if best <= enough:
            break
    return best


@kernel
def make_chart(c: Course, f: Foresight, limit: float, cells: int) -> Chart:
    """Return the chart of offsets up to the limit.

    Args:
        c: the episode.
        f: the states of the car within the limit.
        limit: m.
        cells: along each axis; fewer, where the car has so many states that it would take long.
    """
    complete = f.size[1]
    reachable = reach(c)
    row = np.full(complete, -1, np.int64)
    rows = 0
    for state in range(complete):
        if f.least[state] <= limit:
            row[state] = rows
            rows += 1
    cells = max(_FEWEST, min(cells, int(np.sqrt(_MOST / max(1, rows)))))
    low = -SURE * limit - MARGIN
    cell = -2.0 * low / cells
    slack = np.sqrt(0.5) * cell + MARGIN  # from the middle of a cell to any place in it
    least = np.empty((rows, cells, cells), np.float32)
    first = np.empty((ACTION_COUNT + 1, 2), np.int64)  # cells that an action leads into, relative to where it begins
    last = np.empty((ACTION_COUNT + 1, 2), np.int64)
    velocity = np.empty((ACTION_COUNT + 1, 2))
    shifted_tick = -1
    contacts = np.empty(2)
    children = np.empty(2, np.int64)
    for state in range(complete - 1, -1, -1):
        here = row[state]
        if here < 0:
            continue
        tick = f.tick[state]
        x_phi, y_phi = place_of_phi(c, tick)
        x_phi_to, y_phi_to = place_of_phi(c, tick + 1)
        if tick != shifted_tick:
            shifted_tick = tick
            for action in range(ACTION_COUNT + 1):
                if action == AS_PHI:
                    vx, vy = path_velocity(c.path, tick, c.time_step)
                else:
                    vx, vy = action_velocity(action, c.pedestrian_speed)
                sx, sy = c.time_step * vx - (x_phi_to - x_phi), c.time_step * vy - (y_phi_to - y_phi)
                if max(abs(sx), abs(sy)) <= _SAME:
                    first[action, :], last[action, :] = 0, 0
                else:
                    sx, sy = sx / cell, sy / cell
                    first[action, 0], last[action, 0] = int(np.floor(sx - MARGIN)), int(np.ceil(sx + MARGIN))
                    first[action, 1], last[action, 1] = int(np.floor(sy - MARGIN)), int(np.ceil(sy + MARGIN))
                velocity[action, 0], velocity[action, 1] = vx, vy
        for braking in range(2):
            children[braking] = f.child[state, braking]
            contacts[braking] = np.inf
            if children[braking] >= 0:
                contacts[braking] = contact_cost(c, f.car[state], f.car[children[braking]], tick) - MARGIN
                if contacts[braking] > limit and f.least[children[braking]] == np.inf:
                    children[braking] = -1
        front = f.car[state, 1] + c.front
        allowed = min(limit, reachable[tick])
        for i in range(cells):
            ex = low + (i + 0.5) * cell
            near_x = _nearest(ex - 0.5 * cell, ex + 0.5 * cell)
            outside = x_phi + ex - 0.5 * cell > c.path_edge + MARGIN
            for j in range(cells):
                ey = low + (j + 0.5) * cell
                near_y = _nearest(ey - 0.5 * cell, ey + 0.5 * cell)
                near = np.sqrt(near_x * near_x + near_y * near_y) - MARGIN
                if near > allowed or outside:
                    least[here, i, j] = np.inf
                    continue
                from_front = y_phi + ey - 0.5 * cell - MARGIN - front
                to_front = y_phi + ey + 0.5 * cell + MARGIN - front
                best = np.inf
                for braking in range(2):
                    child = children[braking]
                    if child < 0 or best <= near:  # what is nearer than the offset itself does not count
                        continue
                    if braking == 1 and (to_front < 0.0 or from_front > c.trigger):
                        continue
                    if braking == 0 and from_front >= 0.0 and to_front <= c.trigger:
                        continue
                    if child >= complete:  # of which nothing is known
                        best = 0.0
                    elif row[child] >= 0:
                        best = min(best, _best_next(least[row[child]], i, j, first, last, near))
                    if contacts[braking] < best and contacts[braking] <= limit:
                        for action in range(ACTION_COUNT + 1):
                            if best <= max(near, contacts[braking]):
                                break
                            vx, vy = velocity[action, 0], velocity[action, 1]
                            touched = _contact_bound(c, f.car[state], f.car[child], ex, ey, vx, vy, tick, slack)
                            best = min(best, max(contacts[braking], touched))
                least[here, i, j] = np.float32(max(near, best)) * _BELOW
    return Chart(row, least, low, cell)


@kernel
def no_chart() -> Chart:
    """Return a chart in which nothing is known."""
    return Chart(np.empty(0, np.int64), np.empty((0, 1, 1), np.float32), 0.0, 1.0)


@kernel
def charted(chart: Chart, state: int, ex: float, ey: float) -> float:
    """Return what a pedestrian at an offset from φ (m) still has to stray, or has strayed now, at least (m)."""
    if state >= chart.row.size:
        return 0.0
    row = chart.row[state]
    if row < 0:
        return np.inf
    cells = chart.least.shape[1]
    x, y = (ex - chart.low) / chart.cell, (ey - chart.low) / chart.cell
    best = np.inf
    # Who is on a border, up to rounding, is in both cells.
    for i in range(int(np.floor(x - MARGIN)), int(np.floor(x + MARGIN)) + 1):
        for j in range(int(np.floor(y - MARGIN)), int(np.floor(y + MARGIN)) + 1):
            if 0 <= i < cells and 0 <= j < cells:
                best = min(best, float(chart.least[row, i, j]))
    return best
