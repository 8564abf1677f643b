"""Kernels behind the clairvoyant kamikaze: an exact search for the colliding action sequence that is nearest to φ.

The car's noise is known for every tick, so its state is a function of when it braked. The least Fréchet distance over
all action sequences is a bottleneck path through the nodes (tick, lattice position, car state, j): a coupling is part
of the path, and a link costs |position − φ_j|. For a given limit on the links, all j that some coupling reaches at a
(position, car state) are one bit set F, and a step is linear in it: shift, keep the points of φ within the limit, flood
along φ. Sequences that meet in a position and a car state hence merge by OR, without losing any. The least limit is
found by bisection; it ends when no link lies between the bounds.

Positions are counted in moves (East, diagonals, North − South, North-East − South-East), so that sequences merge
however rounding goes; coordinates are those of one sequence that leads there, and another's differ by rounding only.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from skd_adversary.crossing import ACTION_COUNT, EAST, NORTH, NORTH_EAST, SOUTH, SOUTH_EAST, action_velocity
from skd_sim.compilation import kernel
from skd_sim.controllers import basic_acceleration
from skd_sim.geometry import first_contact
from skd_sim.motion import next_speed, travelled

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
WordArray = npt.NDArray[np.uint64]

NOTHING, FOUND, FULL = range(3)
"""What a search answers: no such sequence, one found, or no room left in the workspace."""

_WORD = 64
_ONE = np.uint64(1)
_ZERO = np.uint64(0)
_TOP = np.uint64(_WORD - 1)
_UNKNOWN, _OUTSIDE = -2, -1  # neighbours not yet looked up, and those further from φ than any limit to come
_TIGHT = 1.0 - 1e-12  # squared links closer than this ratio differ by rounding only
_LAST_MOVES = 4096  # beyond that it is no use to check each
_ENDS = 256  # the same of ends
_GALLOPS = 10  # rounds of widening by doubling steps before all is searched
_NEVER = 1 << 30
_SURE = 1.0 + 1e-9  # margin of prunings


class Course(NamedTuple):
    """One episode in numbers; lengths in m, speeds in m/s, times in s."""

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


class Workspace(NamedTuple):
    """Memory of a search; sizes are limits, `FULL` says that one was met."""

    size: IntArray  # [positions, cars, nodes, edges, stamp, expanded nodes, stamp of the search]
    position_slot: IntArray  # hash table: id + 1, 0 empty
    position_moves: IntArray  # id → packed counts of moves
    position: FloatArray  # id → x, y
    neighbour: IntArray  # id × action → id
    squared: FloatArray  # id × n: squared distance to φ_j
    near: WordArray  # id × words: which φ_j are within the limit
    near_stamp: IntArray
    to_go: IntArray  # id → least number of actions to where ψ can end
    car: FloatArray  # id → x, y, speed
    car_until: IntArray  # id → tick up to which it can hit somebody in time
    child: IntArray  # id × (free, braking) → id at the next tick
    node_position: IntArray
    node_car: IntArray
    reached: WordArray  # node × words: F
    node_edge: IntArray  # newest edge into the node
    edge_from: IntArray
    edge_action: IntArray
    edge_next: IntArray
    layer_slot: IntArray  # hash table of the layer being made
    layer_stamp: IntArray
    standing_slot: IntArray  # hash table: (position, standing car) → node whose `seen` holds what has been reached
    standing_stamp: IntArray
    seen: WordArray


def workspace(points: int, capacity: int) -> Workspace:
    """Return memory for φ of `points` points and `capacity` nodes (a power of two)."""
    words = -(-points // _WORD)
    positions = capacity // 4
    cars = capacity // 4

    def integers(*shape: int) -> IntArray:
        return np.empty(shape, np.int64)

    def zeros(*shape: int) -> IntArray:
        return np.zeros(shape, np.int64)

    return Workspace(
        size=zeros(7),
        position_slot=zeros(2 * positions),
        position_moves=integers(positions),
        position=np.empty((positions, 2)),
        neighbour=integers(positions, ACTION_COUNT),
        squared=np.empty((positions, points)),
        near=np.empty((positions, words), np.uint64),
        near_stamp=zeros(positions),
        to_go=integers(positions),
        car=np.empty((cars, 3)),
        car_until=integers(cars),
        child=integers(cars, 2),
        node_position=integers(capacity),
        node_car=integers(capacity),
        reached=np.empty((capacity, words), np.uint64),
        node_edge=integers(capacity),
        edge_from=integers(2 * capacity),
        edge_action=integers(2 * capacity),
        edge_next=integers(2 * capacity),
        layer_slot=integers(2 * capacity),
        layer_stamp=zeros(2 * capacity),
        standing_slot=integers(2 * capacity),
        standing_stamp=zeros(2 * capacity),
        seen=np.empty((capacity, words), np.uint64),
    )


@kernel
def _hash(key: int, mask: int) -> int:
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
def _place(c: Course, w: Workspace, moves: int, x: float, y: float, limit: float) -> int:
    """Return the id of a lattice position, _OUTSIDE where all of φ is beyond the (squared) limit, or −3: no room."""
    mask = w.position_slot.shape[0] - 1
    slot = _hash(moves, mask)
    while w.position_slot[slot] != 0:
        found = w.position_slot[slot] - 1
        if w.position_moves[found] == moves:
            return found  # type: ignore[no-any-return]
        slot = (slot + 1) & mask
    new = w.size[0]
    if new >= w.position_moves.shape[0]:
        return -3
    least = np.inf
    for j in range(c.path.shape[0]):
        dx, dy = x - c.path[j, 0], y - c.path[j, 1]
        w.squared[new, j] = dx * dx + dy * dy
        least = min(least, w.squared[new, j])
    if least > limit:
        return _OUTSIDE
    w.size[0] = new + 1
    w.position_slot[slot] = new + 1
    w.position_moves[new] = moves
    w.position[new, 0], w.position[new, 1] = x, y
    w.neighbour[new, :] = _UNKNOWN
    w.near_stamp[new] = 0
    return new  # type: ignore[no-any-return]


@kernel
def _mark_near(w: Workspace, place: int, limit: float, ends: IntArray, count: int, stamp: int) -> None:
    """Write which points of φ are within the (squared) limit of a position, and how far it is from where ψ can end."""
    w.near_stamp[place] = stamp
    w.near[place, :] = _ZERO
    for j in range(w.squared.shape[1]):
        if w.squared[place, j] <= limit:
            w.near[place, j >> 6] |= _ONE << np.uint64(j & 63)
    w.to_go[place] = _ticks_to_go(w.position_moves[place], ends, count) if count >= 0 else 0


@kernel
def _ticks_to_go(moves: int, ends: IntArray, count: int) -> int:
    """Return the least number of actions from a position, in packed counts of moves, to any of the ends."""
    a = moves & 0xFFFF
    rest = (moves - a) >> 16
    b = rest & 0xFFFF
    rest = (rest - b) >> 16
    k = ((rest & 0xFFFF) ^ 0x8000) - 0x8000
    e = (rest - k) >> 16
    least = _NEVER
    for i in range(count):
        east, diagonals = ends[i, 0] - a, ends[i, 1] - b
        if east >= 0 and diagonals >= abs(ends[i, 3] - e):
            least = min(least, east + diagonals + abs(ends[i, 2] - k))
    return least


@kernel
def _couple(reached: WordArray, near: WordArray, out: WordArray) -> bool:
    """Write which j a coupling reaches after one more point of ψ; return whether there is any.

    Args:
        reached: j reached at the point before.
        near: j with φ_j within the limit of the new point.
        out: j reached at the new point.
    """
    shifted = _ZERO
    carry = _ZERO
    alive = False
    for k in range(reached.shape[0]):
        near_k = near[k]
        begin = (reached[k] | (reached[k] << _ONE) | shifted) & near_k
        shifted = reached[k] >> _TOP
        # Flood: added to the block of ones that it lies in, a bit turns over all above it.
        total = near_k + begin
        over = total < near_k
        total += carry
        over |= total < carry
        # A carry from the word below floods from bit 0, or ends there where bit 0 is not near.
        out[k] = ((total ^ near_k) | begin) & near_k
        carry = _ONE if over else _ZERO
        alive |= out[k] != _ZERO
    return alive


@kernel
def _child(c: Course, w: Workspace, car: int, braking: int, tick: int) -> int:
    """Return the car's state one tick on, or −1: no room. A standing car stays the same state."""
    known = w.child[car, braking]
    if known >= 0:
        return known  # type: ignore[no-any-return]
    x, y, speed = w.car[car, 0], w.car[car, 1], w.car[car, 2]
    if speed == 0.0:
        w.child[car, braking] = car
        return car
    new = w.size[1]
    if new >= w.car.shape[0]:
        return -1
    w.size[1] = new + 1
    acceleration = -c.deceleration if braking else 0.0
    applied = acceleration + c.noise[tick, 1] * acceleration
    speed_after = next_speed(speed, applied, c.noise[tick, 0], c.time_step)
    distance = travelled(speed, speed_after, c.time_step)
    w.car[new, 0] = x + distance * c.cos_heading
    w.car[new, 1] = y + distance * c.sin_heading
    w.car[new, 2] = speed_after
    w.child[new, :] = -1
    w.child[car, braking] = new
    return new  # type: ignore[no-any-return]


@kernel
def _apart(
    ahead: float, left: float, ahead_to: float, left_to: float, front: float, rear: float, side: float, radius: float
) -> bool:
    """Tell, without the swept test, that there is no contact: both ends are to one side of the car, well off."""
    return (
        min(left, left_to) > _SURE * side
        or max(left, left_to) < -_SURE * side
        or min(ahead, ahead_to) > _SURE * (front + radius)
        or max(ahead, ahead_to) < -_SURE * (rear + radius)
    )


@kernel
def _window(c: Course, limit: float) -> tuple[float, float]:
    """Return the least and the greatest y (m) at which ψ can end within the (squared) limit of the end of φ."""
    x, y = c.path[-1, 0], c.path[-1, 1]
    off = max(0.0, x - c.path_edge - c.time_step * c.pedestrian_speed)  # contact is made from x ≤ path_edge
    if limit < off * off:
        return np.inf, -np.inf
    half = _SURE * np.sqrt(limit - off * off) + 1e-9
    return y - half, y + half


@kernel
def _last_tick(c: Course, car: FloatArray, tick: int, first_braking: int, y_low: float, y_high: float) -> int:
    """Return the last tick in which a car, in its state after `tick`, can hit somebody who ends it in the window.

    It is numbered from 1; 0: there is none.
    A car that brakes at every tick is never ahead of one that does not.
    """
    reach = c.time_step * c.pedestrian_speed
    y, speed = car[1], car[2]
    if speed == 0.0 and y + c.front + c.radius + reach < y_low:
        return 0
    begin = tick
    while y - c.rear - c.radius - reach <= y_high:
        if speed == 0.0 or tick == c.noise.shape[0]:
            return c.noise.shape[0]  # type: ignore[no-any-return]
        acceleration = -c.deceleration if tick >= first_braking else 0.0
        after = next_speed(speed, acceleration + c.noise[tick, 1] * acceleration, c.noise[tick, 0], c.time_step)
        y += travelled(speed, after, c.time_step)
        speed = after
        tick += 1
    return tick if tick > begin else 0


@kernel
def _last_moves(c: Course, limit: float, moves: FloatArray, ends: IntArray) -> tuple[int, int]:
    """Write every move of one tick that can be the last of a ψ, and its ends.

    It ends within the (squared) limit of the end of φ, begins no further East than the car's path reaches, and its end
    is a position that actions lead to.

    Args:
        c: the episode.
        limit: m².
        moves: rows of x, y before and x, y after, m.
        ends: rows of counts of moves: East, diagonals, North − South, North-East − South-East.

    Returns:
        How many moves and how many ends; −1 for each of which there are more than there is room for.
    """
    step = c.time_step * c.pedestrian_speed
    diagonal = step * np.sqrt(0.5)
    start_x, start_y = c.path[0, 0], c.path[0, 1]
    end_x, end_y = c.path[-1, 0], c.path[-1, 1]
    radius = _SURE * np.sqrt(limit) + 1e-9
    east = min(c.path_edge + step, end_x + radius) - start_x + 1e-9
    ticks = c.noise.shape[0]
    count = end_count = 0
    for b in range(min(ticks, int(np.floor(east / diagonal))) + 1):
        for a in range(min(ticks - b, int(np.floor((east - b * diagonal) / step))) + 1):
            x = start_x + a * step + b * diagonal
            if x < end_x - radius:
                continue
            half = np.sqrt(max(0.0, radius * radius - (x - end_x) ** 2)) + 1e-9
            straight = ticks - a - b
            for e in range(-b, b + 1, 2):
                y = start_y + e * diagonal
                low = max(-straight, int(np.ceil((end_y - half - y) / step)))
                high = min(straight, int(np.floor((end_y + half - y) / step)))
                for k in range(low, high + 1):
                    if end_count == ends.shape[0]:
                        end_count = -1
                    if end_count >= 0:
                        ends[end_count, 0], ends[end_count, 1], ends[end_count, 2], ends[end_count, 3] = a, b, k, e
                        end_count += 1
                    for action in range(ACTION_COUNT):
                        vx, vy = action_velocity(action, c.pedestrian_speed)
                        if x - c.time_step * vx > c.path_edge + 1e-9:
                            continue
                        if count == moves.shape[0]:
                            return -1, -1
                        moves[count, 2], moves[count, 3] = x, y + k * step
                        moves[count, 0] = moves[count, 2] - c.time_step * vx
                        moves[count, 1] = moves[count, 3] - c.time_step * vy
                        count += 1
    return count, end_count


@kernel
def _next_end(c: Course, limit: float) -> float:
    """Return the least squared distance (m²) beyond the limit between a lattice position and the end of φ.

    Prunings look ahead to the end of ψ, and so leave out ends beyond the limit that the search has never come to.
    """
    step = c.time_step * c.pedestrian_speed
    diagonal = step * np.sqrt(0.5)
    start_x, start_y = c.path[0, 0], c.path[0, 1]
    end_x, end_y = c.path[-1, 0], c.path[-1, 1]
    east = c.path_edge + step - start_x + 1e-9
    ticks = c.noise.shape[0]
    least = np.inf
    for b in range(min(ticks, int(np.floor(east / diagonal))) + 1):
        for a in range(min(ticks - b, int(np.floor((east - b * diagonal) / step))) + 1):
            dx = start_x + a * step + b * diagonal - end_x
            half = np.sqrt(max(0.0, limit - dx * dx))
            for e in range(-b, b + 1, 2):
                dy = start_y + e * diagonal - end_y
                for edge in (-half, half):
                    middle = int(np.floor((edge - dy) / step))
                    for k in range(middle - 1, middle + 3):
                        squared = dx * dx + (dy + k * step) ** 2
                        if limit < squared < least:
                            least = squared
    return least


@kernel
def _touched_standing(c: Course, car: FloatArray, moves: FloatArray, count: int) -> bool:
    """Tell whether any of the last moves touches a car that stands for good, a touch being taken generously."""
    for i in range(count):
        ahead, left = moves[i, 1] - car[1], car[0] - moves[i, 0]
        ahead_to, left_to = moves[i, 3] - car[1], car[0] - moves[i, 2]
        if _apart(ahead, left, ahead_to, left_to, c.front, c.rear, c.path_edge, c.radius):
            continue
        if first_contact(ahead, left, ahead_to, left_to, c.front, c.rear, c.half_width, c.radius + 1e-9) <= 1.0:
            return True
    return False


@kernel
def _first_braking(c: Course, limit: float) -> int:
    """Return the first tick at which a car can brake for somebody within the (squared) limit of φ.

    It is the widest limit of the whole search, for the links of whoever is further off are not looked at.
    """
    south = np.min(c.path[:, 1]) - _SURE * np.sqrt(limit) - 1e-9
    y, speed = c.car_y, c.car_speed
    for tick in range(c.noise.shape[0]):
        if y + c.front + c.trigger >= south:
            return tick
        after = next_speed(speed, 0.0, c.noise[tick, 0], c.time_step)
        y += travelled(speed, after, c.time_step)
        speed = after
    return c.noise.shape[0]  # type: ignore[no-any-return]


@kernel
def _unseen(w: Workspace, place: int, car: int, fresh: WordArray, stamp: int) -> bool:
    """Keep in `fresh` what has not been reached beside a standing car before; return whether any is left.

    Beside a car that stands for good, reaching the same later is of no use.
    """
    mask = w.standing_slot.shape[0] - 1
    slot = _hash((car << 32) | place, mask)
    while w.standing_stamp[slot] == stamp:
        entry = w.standing_slot[slot]
        if w.node_position[entry] == place and w.node_car[entry] == car:
            alive = False
            for k in range(fresh.shape[0]):
                fresh[k] &= ~w.seen[entry, k]
                alive |= fresh[k] != _ZERO
                w.seen[entry, k] |= fresh[k]
            return alive
        slot = (slot + 1) & mask
    entry = w.size[2]  # the node that is about to be made for it
    w.standing_stamp[slot] = stamp
    w.standing_slot[slot] = entry
    w.seen[entry, :] = fresh
    return True


@kernel
def _join(w: Workspace, place: int, car: int, fresh: WordArray, origin: int, action: int, stamp: int) -> bool:
    """Add what has been reached to the layer being made; return False where there is no room."""
    mask = w.layer_slot.shape[0] - 1
    slot = _hash((car << 32) | place, mask)
    node = -1
    while w.layer_stamp[slot] == stamp:
        entry = w.layer_slot[slot]
        if w.node_position[entry] == place and w.node_car[entry] == car:
            node = entry
            break
        slot = (slot + 1) & mask
    if node < 0:
        node = w.size[2]
        w.size[2] = node + 1
        w.layer_stamp[slot] = stamp
        w.layer_slot[slot] = node
        w.node_position[node] = place
        w.node_car[node] = car
        w.reached[node, :] = fresh
        w.node_edge[node] = -1
    else:
        new = False
        for k in range(fresh.shape[0]):
            new |= (fresh[k] & ~w.reached[node, k]) != _ZERO
            w.reached[node, k] |= fresh[k]
        if not new:
            return True
    edge = w.size[3]
    if edge >= w.edge_from.shape[0]:
        return False
    w.size[3] = edge + 1
    w.edge_from[edge] = origin
    w.edge_action[edge] = action
    w.edge_next[edge] = w.node_edge[node]
    w.node_edge[node] = edge
    return True


@kernel
def _decide(c: Course, w: Workspace, limit: float, widest: float) -> tuple[int, int, int]:
    """Search for a colliding sequence whose couplings need no link beyond the limit.

    Args:
        c: the episode.
        w: memory; positions stay in it from one call to the next.
        limit: on squared links, m².
        widest: no later call will have a higher limit, m².

    Returns:
        (FOUND, last node, last action), or (NOTHING or FULL, −1, −1).
    """
    ticks = c.noise.shape[0]
    reach = c.time_step * c.pedestrian_speed
    last_word, last_bit = (c.path.shape[0] - 1) >> 6, _ONE << np.uint64((c.path.shape[0] - 1) & 63)
    w.size[4] += 1
    points = c.path.shape[0]
    radius = _SURE * np.sqrt(limit)  # around the end of φ, where ψ has to end
    y_low, y_high = _window(c, limit)
    first_braking = _first_braking(c, widest)
    last = np.empty((_LAST_MOVES, 4))
    ends = np.empty((_ENDS, 4), np.int64)
    last_moves, end_count = _last_moves(c, limit, last, ends) if limit < np.inf else (-1, -1)
    search = w.size[4]
    w.size[6] = search
    fresh = np.zeros(w.near.shape[1], np.uint64)
    none = np.zeros_like(fresh)
    none[0] = _ONE  # φ_0
    w.car[0, 0], w.car[0, 1], w.car[0, 2] = c.car_x, c.car_y, c.car_speed
    w.child[0, :] = -1
    _mark_near(w, 0, limit, ends, end_count, search)
    _couple(none, w.near[0], fresh)
    w.node_position[0], w.node_car[0], w.node_edge[0] = 0, 0, -1
    w.reached[0, :] = fresh
    w.size[1], w.size[2], w.size[3] = 1, 1, 0
    begin, end = 0, 1
    for tick in range(ticks):
        w.size[4] += 1
        layer = w.size[4]
        w.size[5] += end - begin
        for node in range(begin, end):
            place, car = w.node_position[node], w.node_car[node]
            x, y = w.position[place, 0], w.position[place, 1]
            dx, dy = x - w.car[car, 0], y - w.car[car, 1]
            ahead, left = c.cos_heading * dx + c.sin_heading * dy, c.cos_heading * dy - c.sin_heading * dx
            braking = 1 if basic_acceleration(ahead - c.front, c.trigger, c.deceleration) != 0.0 else 0
            known = w.size[1]
            child = _child(c, w, car, braking, tick)
            if child < 0:
                return FULL, -1, -1
            if child >= known:
                w.car_until[child] = _last_tick(c, w.car[child], tick + 1, first_braking, y_low, y_high)
                if (
                    last_moves >= 0
                    and w.car[child, 2] == 0.0
                    and not _touched_standing(c, w.car[child], last, last_moves)
                ):
                    w.car_until[child] = 0
            until = w.car_until[child]
            speed, speed_after = w.car[car, 2], w.car[child, 2]
            for action in range(ACTION_COUNT):
                to = w.neighbour[place, action]
                if to == _OUTSIDE:
                    continue
                if to == _UNKNOWN:
                    vx, vy = action_velocity(action, c.pedestrian_speed)
                    moves = w.position_moves[place] + _moves(action)
                    to = _place(c, w, moves, x + c.time_step * vx, y + c.time_step * vy, widest)
                    if to == -3:
                        return FULL, -1, -1
                    w.neighbour[place, action] = to
                    if to == _OUTSIDE:
                        continue
                if w.near_stamp[to] < search:
                    _mark_near(w, to, limit, ends, end_count, search)
                if not _couple(w.reached[node], w.near[to], fresh):
                    continue
                x_to, y_to = w.position[to, 0], w.position[to, 1]
                dx, dy = x_to - w.car[child, 0], y_to - w.car[child, 1]
                ahead_to = c.cos_heading * dx + c.sin_heading * dy
                left_to = c.cos_heading * dy - c.sin_heading * dx
                fraction = np.inf
                if not _apart(ahead, left, ahead_to, left_to, c.front, c.rear, c.path_edge, c.radius):
                    fraction = first_contact(ahead, left, ahead_to, left_to, c.front, c.rear, c.half_width, c.radius)
                if fraction <= 1.0 and speed + fraction * (speed_after - speed) >= c.minimum_impact_speed:
                    if fresh[last_word] & last_bit:
                        return FOUND, node, action
                    continue
                if x_to > c.path_edge or until <= tick + max(1, w.to_go[to]):
                    continue
                farthest = radius + _SURE * reach * (until - tick - 1)
                if w.squared[to, points - 1] > farthest * farthest:
                    continue
                if (
                    ahead_to < -_SURE * (c.rear + c.radius)
                    and speed_after * c.slowest[tick + 1] >= _SURE * c.pedestrian_speed
                ):
                    continue  # it has passed, will not brake any more and is never slower than the pedestrian
                if w.size[2] >= w.node_car.shape[0]:
                    return FULL, -1, -1
                if speed_after == 0.0 and (c.minimum_impact_speed > 0.0 or not _unseen(w, to, child, fresh, search)):
                    continue
                if not _join(w, to, child, fresh, node, action, layer):
                    return FULL, -1, -1
        begin, end = end, w.size[2]
        if begin == end:
            break
    return NOTHING, -1, -1


@kernel
def _has(words: WordArray, j: int) -> bool:
    return bool((words[j >> 6] >> np.uint64(j & 63)) & _ONE)


@kernel
def _origin(w: Workspace, node: int, place: int, j: int) -> int:
    """Return which j at `node` a coupling comes from that has reached φ_j at the next point, `place`; −1: none."""
    while j >= 0 and _has(w.near[place], j):
        if _has(w.reached[node], j):
            return j
        if j > 0 and _has(w.reached[node], j - 1):
            return j - 1
        j -= 1
    return -1


@kernel
def _trace(c: Course, w: Workspace, node: int, action: int, actions: IntArray) -> int:
    """Write the sequence that ends with `action` at `node`; return its length."""
    length = 0
    actions[0] = action
    j = _origin(w, node, w.neighbour[w.node_position[node], action], c.path.shape[0] - 1)
    while node != 0:
        length += 1
        edge = w.node_edge[node]
        while True:
            before = _origin(w, w.edge_from[edge], w.node_position[node], j)
            if before >= 0:
                break
            edge = w.edge_next[edge]
        actions[length] = w.edge_action[edge]
        node, j = w.edge_from[edge], before
    length += 1
    actions[:length] = actions[:length][::-1].copy()
    return length


@kernel
def _bottleneck(w: Workspace, actions: IntArray, length: int) -> float:
    """Return the squared discrete Fréchet distance of a sequence."""
    n = w.squared.shape[1]
    row = np.empty(n)
    row[0] = w.squared[0, 0]
    for j in range(1, n):
        row[j] = max(row[j - 1], w.squared[0, j])
    place = 0
    for i in range(length):
        place = w.neighbour[place, actions[i]]
        corner = row[0]
        row[0] = max(row[0], w.squared[place, 0])
        for j in range(1, n):
            least = min(row[j], corner, row[j - 1])
            corner = row[j]
            row[j] = max(least, w.squared[place, j])
    return row[n - 1]  # type: ignore[no-any-return]


@kernel
def search_floor(c: Course, w: Workspace, upper: float, actions: IntArray) -> tuple[int, float, int]:
    """Search for the colliding sequence with the least discrete Fréchet distance from φ.

    Args:
        c: the episode.
        w: memory, fresh.
        upper: only distances up to this are looked for, m; infinity: all.
        actions: room for one action per tick; receives the sequence.

    Returns:
        (FOUND, distance in m, number of actions), or (NOTHING or FULL, infinity, 0).
    """
    widest = upper * upper
    low, high = 0.0, widest
    found = 0
    _place(c, w, 0, c.path[0, 0], c.path[0, 1], np.inf)
    trial = np.empty_like(actions)
    rounds = 0
    step = 0.1  # m
    gap = max(0.0, c.path[-1, 0] - c.path_edge - c.time_step * c.pedestrian_speed)
    low = gap * gap
    while low < high * _TIGHT or (found == 0 and low <= high):
        lower = np.sqrt(low)
        limit = (lower + step) ** 2
        if limit >= high or found:
            middle = 0.5 * (lower + np.sqrt(high))
            limit = middle * middle
            if found == 0 and limit * _SURE >= high:
                limit = high
        step *= 2.0
        if rounds == _GALLOPS:
            limit = high
        rounds += 1
        state, node, action = _decide(c, w, limit, high)
        if state == FULL:
            return FULL, np.inf, 0
        if state == FOUND:
            length = _trace(c, w, node, action, trial)
            value = _bottleneck(w, trial, length)
            high = value
            found = length
            actions[:length] = trial[:length]
        else:
            if limit >= high:
                break
            # The least link that was too long: nothing is gained by any limit below it.
            above = _next_end(c, limit)
            for place in range(w.size[0]):
                if w.near_stamp[place] >= w.size[6]:
                    for j in range(w.squared.shape[1]):
                        if limit < w.squared[place, j] < above:
                            above = w.squared[place, j]
            low = above
    if found == 0:
        return NOTHING, np.inf, 0
    return FOUND, np.sqrt(high), found
