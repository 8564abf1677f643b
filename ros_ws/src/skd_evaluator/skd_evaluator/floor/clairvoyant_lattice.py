"""The lattice of positions that actions lead to, and how many actions it still takes from there to an end of ψ.

Positions are counted in moves (East, diagonals, North − South, North-East − South-East), so that sequences merge
however rounding goes; coordinates are those of one sequence that leads there, and another's differ by rounding only.
No action leads West and an episode is over East of the car's path: near φ there are only a few thousand positions,
however long the horizon.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from skd_adversary.model.road_user.pedestrian import (
    ACTION_COUNT,
    EAST,
    NORTH,
    NORTH_EAST,
    SOUTH,
    SOUTH_EAST,
    action_velocity,
)
from skd_sim.arrays import FloatArray, IntArray
from skd_sim.kernels.compilation import kernel

from skd_evaluator.margin.exact.course import MARGIN, SURE, Course

NEVER = 1 << 30


class Lattice(NamedTuple):
    """Memory for the positions; their id is a row in each array."""

    slot: IntArray  # hash table: id + 1, 0 empty
    moves: IntArray  # packed counts of moves
    position: FloatArray  # x, y, m
    neighbour: IntArray  # id × action → id, −1: too far from φ or beyond the car's path
    origin: IntArray  # id × action → id from where the action leads here, −1: none
    squared: FloatArray  # id × n: squared distance to φ_j, m²
    to_go: IntArray  # id × n: least number of actions from here to an end of ψ for a coupling at φ_j
    entered: IntArray  # id × n: whether a coupling that comes here with φ_j has been counted in `to_go`
    nearest: IntArray  # least of `to_go`
    queue: IntArray


def make_lattice(points: int, capacity: int) -> Lattice:
    """Return memory for φ of `points` points and `capacity` positions (a power of two)."""

    def integers(*shape: int) -> IntArray:
        return np.empty(shape, np.int64)

    return Lattice(
        slot=integers(2 * capacity),
        moves=integers(capacity),
        position=np.empty((capacity, 2)),
        neighbour=integers(capacity, ACTION_COUNT),
        origin=integers(capacity, ACTION_COUNT),
        squared=np.empty((capacity, points)),
        to_go=integers(capacity, points),
        entered=integers(capacity, points),
        nearest=integers(capacity),
        queue=integers(capacity * points),
    )


@kernel
def hash_of(key: int, mask: int) -> int:
    """Return a slot of a hash table whose size is mask + 1, a power of two."""
    mixed = key * 0x9E3779B97F4A7C1
    return (mixed ^ (mixed >> 29)) & mask


@kernel
def _moves(action: int) -> int:
    """Return what an action adds to the packed counts of moves (16 bits each)."""
    if action == EAST:
        return 1
    if action == NORTH:
        return 1 << 32
    if action == SOUTH:
        return -(1 << 32)
    if action == NORTH_EAST:
        return (1 << 16) + (1 << 48)
    if action == SOUTH_EAST:
        return (1 << 16) - (1 << 48)
    return 0


@kernel
def _place(c: Course, lattice: Lattice, count: int, moves: int, x: float, y: float, limit: float) -> int:
    """Return the id of a position, `count` where it is new, −1 where all of φ is beyond the limit, −2: no room."""
    mask = lattice.slot.shape[0] - 1
    slot = hash_of(moves, mask)
    while lattice.slot[slot] != 0:
        found = lattice.slot[slot] - 1
        if lattice.moves[found] == moves:
            return found  # type: ignore[no-any-return]
        slot = (slot + 1) & mask
    if count == lattice.moves.shape[0]:
        return -2
    least = np.inf
    for j in range(c.path.shape[0]):
        dx, dy = x - c.path[j, 0], y - c.path[j, 1]
        lattice.squared[count, j] = dx * dx + dy * dy
        least = min(least, lattice.squared[count, j])
    if least > limit:
        return -1
    lattice.slot[slot] = count + 1
    lattice.moves[count] = moves
    lattice.position[count, 0], lattice.position[count, 1] = x, y
    lattice.origin[count, :] = -1
    lattice.to_go[count, :] = NEVER
    lattice.entered[count, :] = 0
    lattice.nearest[count] = NEVER
    return count


@kernel
def spread(c: Course, lattice: Lattice, limit: float) -> int:
    """Fill in all positions that one can come to within the (squared) limit of φ; the start is id 0.

    Returns:
        How many there are; −1: no room.
    """
    lattice.slot[:] = 0
    _place(c, lattice, 0, 0, c.path[0, 0], c.path[0, 1], np.inf)
    begin, count = 0, 1
    for _ in range(c.noise.shape[0]):
        end = count
        for place in range(begin, end):
            x, y = lattice.position[place, 0], lattice.position[place, 1]
            for action in range(ACTION_COUNT):
                vx, vy = action_velocity(action, c.adversary_speed)
                x_to, y_to = x + c.time_step * vx, y + c.time_step * vy
                to = -1
                if x_to <= c.path_edge:
                    to = _place(c, lattice, count, lattice.moves[place] + _moves(action), x_to, y_to, limit)
                    if to == -2:
                        return -1
                    if to == count:
                        count += 1
                lattice.neighbour[place, action] = to
                if to >= 0:
                    lattice.origin[to, action] = place
        if end == count:
            return count
        begin = end
    for place in range(begin, count):  # there is no time left to leave these
        lattice.neighbour[place, :] = -1
    return count


@kernel
def _squared_to_segment(
    x: float, y: float, ax: float, ay: float, dx: float, dy: float, low: float, high: float
) -> float:
    """Return the squared distance of (x, y) from the points a + s·d, low ≤ s ≤ high."""
    length = dx * dx + dy * dy
    s = low
    if length > 0.0:
        s = min(high, max(low, ((x - ax) * dx + (y - ay) * dy) / length))
    ex, ey = ax + s * dx - x, ay + s * dy - y
    return ex * ex + ey * ey


@kernel
def _first_last(c: Course, x: float, y: float, action: int, limit: float) -> int:
    """Return the least j from which a coupling at (x, y) can come to its end if this action is the last; n: none.

    ψ ends in a contact somewhere on the way, with |x| ≤ `path_edge`. All of φ from there on is then within the limit of
    one point of the way; here each may be of another.
    """
    n = c.path.shape[0]
    vx, vy = action_velocity(action, c.adversary_speed)
    dx, dy = c.time_step * vx, c.time_step * vy
    low, high = 0.0, 1.0
    if dx > 0.0:
        low = max(low, (-c.path_edge - MARGIN - x) / dx)
        high = min(high, (c.path_edge + MARGIN - x) / dx)
    elif abs(x) > c.path_edge + MARGIN:
        return n  # type: ignore[no-any-return]
    if low > high:
        return n  # type: ignore[no-any-return]
    j = n
    bound = (SURE * np.sqrt(limit) + MARGIN) ** 2
    while j > 0 and _squared_to_segment(c.path[j - 1, 0], c.path[j - 1, 1], x, y, dx, dy, low, high) <= bound:
        j -= 1
    return n if j == n else max(0, j - 1)  # type: ignore[no-any-return]


@kernel
def count_to_go(c: Course, lattice: Lattice, count: int, limit: float) -> None:
    """Fill in `to_go` and `nearest`: a search from the ends backwards, without regard to the car."""
    n = c.path.shape[0]
    tail = 0
    for place in range(count):
        first = n
        for action in range(ACTION_COUNT):
            first = min(first, _first_last(c, lattice.position[place, 0], lattice.position[place, 1], action, limit))
        for j in range(first, n):
            if lattice.squared[place, j] <= limit:
                lattice.to_go[place, j] = 1
                lattice.queue[tail] = place * n + j
                tail += 1
    head = 0
    while head < tail:
        place, j = lattice.queue[head] // n, lattice.queue[head] % n
        head += 1
        actions = lattice.to_go[place, j] + 1
        lattice.nearest[place] = min(lattice.nearest[place], actions - 1)
        # Whoever comes here with an earlier j can go on to this one while all between are near.
        while j >= 0 and lattice.squared[place, j] <= limit and lattice.entered[place, j] == 0:
            lattice.entered[place, j] = 1
            for action in range(ACTION_COUNT):
                origin = lattice.origin[place, action]
                if origin < 0:
                    continue
                for k in range(max(0, j - 1), j + 1):
                    if lattice.to_go[origin, k] == NEVER and lattice.squared[origin, k] <= limit:
                        lattice.to_go[origin, k] = actions
                        lattice.queue[tail] = origin * n + k
                        tail += 1
            j -= 1
