"""Kernels behind the least deformation: an exact best-first search over sequences of the seven actions.

The least deformation over all colliding sequences is a bottleneck path through the nodes (tick, position, state of the
car), a step costing how far from φ one is after it. Nodes are taken in the order of the greatest cost on the way to
them or, where that is more, of what is still to come at least; the first contact that is not above what is left is the
least. Positions are the sums of moves that led there, whatever their order, so sequences merge however rounding goes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from skd_adversary.model.road_user.pedestrian import (
    ACTION_COUNT,
    AS_PHI,
    EAST,
    NORTH,
    NORTH_EAST,
    SOUTH,
    SOUTH_EAST,
    action_velocity,
)
from skd_adversary.model.safe_path import path_velocity
from skd_sim.compilation import kernel
from skd_sim.controllers import basic_acceleration
from skd_sim.geometry import first_contact

from skd_evaluator.floor.clairvoyant_chart import Chart, charted, make_chart, no_chart
from skd_evaluator.floor.clairvoyant_course import SURE, Course
from skd_evaluator.floor.clairvoyant_foresight import NEVER, Foresight, foresee, next_state, place_of_phi, reach
from skd_evaluator.floor.clairvoyant_lattice import hash_of

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

NOTHING, FOUND, FULL = range(3)
"""What a search answers: no such sequence, one found, or no room left."""

_SAME = 1e-12  # m, between displacements of φ that are one
_TIGHT = 1.0 - 1e-12  # distances closer than this ratio differ by rounding only
_FIRST_LIMIT = 0.25  # m
_NEXT, _MORE = 1.1, 0.05  # from what is proven to the next limit: a ratio, and m
_LOOSER = 1.2  # from a limit within which there is no room to search to the next
_WORTH = 0.7  # of a limit: below this a chart for the lower limit is worth its time
_EAST_KEY, _NORTH_KEY, _NORTH_EAST_KEY, _SOUTH_EAST_KEY = (
    0x1F3A5B7C9D2E4F61,
    0x2545F4914F6CDD1D,
    0x369DEA0F31A53F85,
    0x106689D45497FDB5,
)


class Queue(NamedTuple):
    """Memory for the nodes of a search, and for the heap of those to be taken."""

    size: IntArray  # [nodes, heap]
    position: FloatArray  # node → x, y, m
    key: IntArray  # node → sum of the keys of its moves: the same for the same moves in another order
    car: IntArray  # node → state of the car
    strayed: FloatArray  # node → greatest distance from φ so far, m
    origin: IntArray  # node → node before
    action: IntArray  # node → action that led here
    slot: IntArray  # hash table: node + 1, 0 empty
    heap_cost: FloatArray
    heap_node: IntArray


def make_queue(capacity: int) -> Queue:
    """Return memory for this many nodes, a power of two."""

    def integers() -> IntArray:
        return np.empty(capacity, np.int64)

    return Queue(
        size=np.zeros(2, np.int64),
        position=np.empty((capacity, 2)),
        key=integers(),
        car=integers(),
        strayed=np.empty(capacity),
        origin=integers(),
        action=integers(),
        slot=np.zeros(2 * capacity, np.int64),
        heap_cost=np.empty(capacity),
        heap_node=integers(),
    )


@kernel
def _mix(number: int) -> int:
    """Return 64 bits that look drawn at random (splitmix64's finaliser), for 0, 1, 2, …."""
    mixed = (number + 1) * -0x61C8864680B583EB
    mixed = (mixed ^ ((mixed >> 30) & 0x3FFFFFFFF)) * -0x40A7B892E31B1A47
    mixed = (mixed ^ ((mixed >> 27) & 0x1FFFFFFFFF)) * -0x6B2FB644ECCEEE15
    return mixed ^ ((mixed >> 31) & 0x1FFFFFFFF)


@kernel
def _key_of(action: int) -> int:
    """Return what an action adds to a key: North and South take each other back, and so do no other moves."""
    if action == EAST:
        return _EAST_KEY
    if action == NORTH:
        return _NORTH_KEY
    if action == SOUTH:
        return -_NORTH_KEY
    if action == NORTH_EAST:
        return _NORTH_EAST_KEY
    if action == SOUTH_EAST:
        return _SOUTH_EAST_KEY
    return 0


@kernel
def keys_as_phi(c: Course) -> IntArray:
    """Return, per tick, what moving as φ does adds to a key; 0 where one of the other actions does the same.

    φ's own steps are numbered by their displacement, so that two of the same are one. There is no key 0 among them but
    for those that are left out.
    """
    ticks = c.noise.shape[0]
    keys = np.zeros(ticks, np.int64)
    for tick in range(min(ticks, c.path.shape[0] - 1)):
        vx, vy = path_velocity(c.path, tick, c.time_step)
        known = False
        for action in range(ACTION_COUNT):
            ux, uy = action_velocity(action, c.pedestrian_speed)
            known |= max(abs(vx - ux), abs(vy - uy)) * c.time_step <= _SAME
        if known:
            continue
        keys[tick] = _mix(tick)
        for before in range(tick):
            ux, uy = path_velocity(c.path, before, c.time_step)
            if keys[before] != 0 and max(abs(vx - ux), abs(vy - uy)) * c.time_step <= _SAME:
                keys[tick] = keys[before]
                break
    return keys


@kernel
def _before(f: Foresight, q: Queue, cost: float, node: int, other_cost: float, other: int) -> bool:
    """Tell which of two nodes is taken first: the cheaper one, of equals the one nearer to an end, then the older."""
    if cost != other_cost:
        return cost < other_cost
    tick, other_tick = f.tick[q.car[node]], f.tick[q.car[other]]
    return tick > other_tick if tick != other_tick else node < other


@kernel
def _push(f: Foresight, q: Queue, cost: float, node: int) -> None:
    place = q.size[1]
    q.size[1] = place + 1
    while place > 0:
        parent = (place - 1) >> 1
        if not _before(f, q, cost, node, q.heap_cost[parent], q.heap_node[parent]):
            break
        q.heap_cost[place], q.heap_node[place] = q.heap_cost[parent], q.heap_node[parent]
        place = parent
    q.heap_cost[place], q.heap_node[place] = cost, node


@kernel
def _pop(f: Foresight, q: Queue) -> tuple[float, int]:
    cost, node = q.heap_cost[0], q.heap_node[0]
    count = q.size[1] - 1
    q.size[1] = count
    last_cost, last = q.heap_cost[count], q.heap_node[count]
    place = 0
    while 2 * place + 1 < count:
        child = 2 * place + 1
        if child + 1 < count and _before(
            f, q, q.heap_cost[child + 1], q.heap_node[child + 1], q.heap_cost[child], q.heap_node[child]
        ):
            child += 1
        if not _before(f, q, q.heap_cost[child], q.heap_node[child], last_cost, last):
            break
        q.heap_cost[place], q.heap_node[place] = q.heap_cost[child], q.heap_node[child]
        place = child
    q.heap_cost[place], q.heap_node[place] = last_cost, last
    return cost, node


@kernel
def _visit(q: Queue, x: float, y: float, key: int, car: int, strayed: float, origin: int, action: int) -> int:
    """Return the new node for what has been reached; −1: it was reached before with no more; −2: no room."""
    mask = q.slot.shape[0] - 1
    slot = hash_of(key ^ (car * 0x5851F42D4C957F2D), mask)
    while q.slot[slot] != 0:
        known = q.slot[slot] - 1
        if q.key[known] == key and q.car[known] == car:
            if q.strayed[known] <= strayed:
                return -1
            break
        slot = (slot + 1) & mask
    node = q.size[0]
    if node >= q.key.shape[0]:
        return -2
    q.size[0] = node + 1
    q.slot[slot] = node + 1
    q.position[node, 0], q.position[node, 1] = x, y
    q.key[node] = key
    q.car[node] = car
    q.strayed[node] = strayed
    q.origin[node] = origin
    q.action[node] = action
    return node  # type: ignore[no-any-return]


@kernel
def _apart(c: Course, ahead: float, left: float, ahead_to: float, left_to: float) -> bool:
    """Tell, without the swept test, that there is no contact: both ends are to one side of the car, well off."""
    return (
        min(left, left_to) > SURE * c.path_edge
        or max(left, left_to) < -SURE * c.path_edge
        or min(ahead, ahead_to) > SURE * (c.front + c.radius)
        or max(ahead, ahead_to) < -SURE * (c.rear + c.radius)
    )


@kernel
def _search_within(
    c: Course, f: Foresight, chart: Chart, q: Queue, keys: IntArray, limit: float, tolerance: float
) -> tuple[int, int, int, float]:
    """Search for the colliding sequence of least deformation, up to the limit for which `f` and `chart` were made.

    Returns:
        (FOUND, node before the last action, last action, distance in m), or (NOTHING or FULL, −1, −1, infinity).
    """
    q.size[:] = 0
    q.slot[:] = 0
    best, best_node, best_action = np.inf, -1, -1
    ticks = c.noise.shape[0]
    root = _visit(q, c.path[0, 0], c.path[0, 1], 0, 0, 0.0, -1, -1)
    if f.least[0] <= limit:
        _push(f, q, f.least[0], root)
    while q.size[1] > 0:
        cost, node = _pop(f, q)
        if cost > limit:
            break
        car = q.car[node]
        tick = f.tick[car]
        if tick >= ticks:
            continue
        x, y, strayed = q.position[node, 0], q.position[node, 1], q.strayed[node]
        dx, dy = x - f.car[car, 0], y - f.car[car, 1]
        ahead, left = c.cos_heading * dx + c.sin_heading * dy, c.cos_heading * dy - c.sin_heading * dx
        braking = 1 if basic_acceleration(ahead - c.front, c.trigger, c.deceleration) != 0.0 else 0
        if f.child[car, braking] == NEVER:
            continue
        after = next_state(c, f, car, braking)
        if after < 0:
            return FULL, -1, -1, np.inf
        x_car, y_car = f.car[after, 0], f.car[after, 1]
        speed, speed_after = f.car[car, 2], f.car[after, 2]
        x_phi, y_phi = place_of_phi(c, tick)
        x_phi_to, y_phi_to = place_of_phi(c, tick + 1)
        for action in range(ACTION_COUNT + 1):
            if action == AS_PHI:
                if keys[tick] == 0:
                    continue
                vx, vy = path_velocity(c.path, tick, c.time_step)
                key = q.key[node] + keys[tick]
            else:
                vx, vy = action_velocity(action, c.pedestrian_speed)
                key = q.key[node] + _key_of(action)
            x_to, y_to = x + c.time_step * vx, y + c.time_step * vy
            dx, dy = x_to - x_car, y_to - y_car
            ahead_to = c.cos_heading * dx + c.sin_heading * dy
            left_to = c.cos_heading * dy - c.sin_heading * dx
            fraction = np.inf
            if not _apart(c, ahead, left, ahead_to, left_to):
                fraction = first_contact(ahead, left, ahead_to, left_to, c.front, c.rear, c.half_width, c.radius)
            if fraction <= 1.0 and speed + fraction * (speed_after - speed) >= c.minimum_impact_speed:
                away_x = x + fraction * (x_to - x) - (x_phi + fraction * (x_phi_to - x_phi))
                away_y = y + fraction * (y_to - y) - (y_phi + fraction * (y_phi_to - y_phi))
                distance = max(strayed, np.sqrt(away_x * away_x + away_y * away_y))
                if distance < best and distance <= limit:
                    best, best_node, best_action = distance, node, action
                    limit = best * _TIGHT - tolerance  # from here on only better ones matter
                continue
            if x_to > c.path_edge:
                continue
            away_x, away_y = x_to - x_phi_to, y_to - y_phi_to
            distance = max(strayed, np.sqrt(away_x * away_x + away_y * away_y))
            total = max(distance, f.least[after])
            if total > limit:
                continue
            total = max(total, charted(chart, after, away_x, away_y))
            if total > limit:
                continue
            new = _visit(q, x_to, y_to, key, after, distance, node, action)
            if new == -2:
                return FULL, -1, -1, np.inf
            if new >= 0:
                if tolerance > 0.0:
                    total = tolerance * np.floor(total / tolerance)
                _push(f, q, total, new)
    return (FOUND if best_node >= 0 else NOTHING), best_node, best_action, best


@kernel(nogil=True)  # a hard one takes seconds, in which a worker has to give signs of life
def search_least_deformation(
    c: Course, f: Foresight, q: Queue, upper: float, cells: int, tolerance: float, loose: bool, actions: IntArray
) -> tuple[int, float, float, int]:
    """Search for the colliding sequence of least deformation.

    Args:
        c: the episode.
        f: memory.
        q: memory.
        upper: only distances up to this are looked for, m; infinity: all.
        cells: of a chart along each axis; 0: no chart.
        tolerance: m by which what is found may be above the least.
        loose: where there is no room to search within a limit, go on to a greater one, in which something is found
            sooner; the gap may then be greater than the tolerance.
        actions: room for one action per tick; receives the sequence.

    Returns:
        (FOUND, distance in m, by how much the least may be below it in m, number of actions), or (NOTHING or FULL,
        infinity, 0, 0).
    """
    keys = keys_as_phi(c)
    farthest = min(upper, float(reach(c)[c.noise.shape[0]]))
    limit = min(_FIRST_LIMIT, farthest)
    chart = no_chart()
    below = 0.0  # m, up to which there is nothing
    full = False
    while True:
        foresee(c, f, limit, f.car.shape[0] // 2)
        if cells > 0 and f.least[0] <= limit:
            chart = make_chart(c, f, limit, cells)
            if not full:
                below = max(below, min(limit, charted(chart, 0, 0.0, 0.0)))
                near = _NEXT * below + _MORE
                if near < _WORTH * limit:  # a smaller limit has smaller cells
                    limit = near
                    continue
        state, node, action, best = _search_within(c, f, chart, q, keys, limit, tolerance)
        if state == FOUND:
            break
        if state == FULL:
            full = True
        if limit >= farthest or (full and not loose):
            return state, np.inf, 0.0, 0
        if full:
            limit = min(_LOOSER * limit, farthest)
        else:
            below = limit
            limit = min(2.0 * limit, farthest)
    gap = max(0.0, best - below) if full else min(tolerance, max(0.0, best - below))
    length = 1
    actions[0] = action
    while q.origin[node] >= 0:
        actions[length] = q.action[node]
        length += 1
        node = q.origin[node]
    actions[:length] = actions[:length][::-1].copy()
    return FOUND, best, gap, length
