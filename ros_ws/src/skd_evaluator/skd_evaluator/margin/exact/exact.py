"""The exact margin of the basic car: the least deviation with which it could have hit in a trial.

A trial's draws do not depend on what the adversary does, and what the basic car answers to every sequence of moves is
known. The search is over all of them. If it runs out of memory, which happens where all steps of φ differ,
`Hit.gap` says how far the result may be from the least.

The kernels go through all places that the adversary can reach within a limit, tick by tick. A node is a place, a state
of the car, and the least deviation of a trajectory that leads there. A node is left out if the reachability bound shows
that no hit can follow. Sequences that come to the same place merge: a place is the sum of moves, whatever their order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from skd_sim.controllers.basic import BasicController
from skd_sim.errors import UsageError
from skd_sim.kernels.compilation import kernel
from skd_sim.world.contact import first_contact
from skd_sim.world.episode import EpisodeSpec, controller_generator, controller_seed
from skd_sim.world.state import FloatArray, IntArray, Trajectory
from skd_sim.world.world import Contact, make_world

from skd_evaluator.margin.actions import MOVE_COUNT, move_velocity, require_exact
from skd_evaluator.margin.exact.reachability import (
    SURE,
    ExactProblem,
    Reachability,
    fill_moves,
    is_hopeful,
    make_problem,
    make_reachability,
    place_of_phi,
    reach_backwards,
    reach_forwards,
    where_of,
)
from skd_evaluator.metrics.deviation import Hit, deviation

_EFFORTS = ((1 << 10, 1 << 12, False), (1 << 13, 1 << 16, True), (1 << 17, 1 << 18, True))
"""Tried one after the other until one has room: histories, nodes, and whether a gap will do."""
TOLERANCE = 1e-9
"""m, between a search and the trajectory that the world gives for its moves."""


def exact_margin(episode: EpisodeSpec, upper_bound: float | None = None) -> Hit | None:
    """Return the hit of least deviation, under an episode's draws.

    A hit is a contact at `collision.hit_speed` or more of the car's own speed. A slower one that the world counts ends
    a trajectory without a hit; one below `collision.minimum_impact_speed` does not end it.

    Args:
        episode: kamikaze mode, basic controller, basic car, pedestrian; its objective does not matter.
        upper_bound: only hits of at most this deviation (m) are looked for; the scenario's `eta_max` by default.

    Returns:
        The hit; None where there is none within the bound and the horizon, or, where there was no room for all, none
        was found: then the least, if there is one, is just below the bound.

    Raises:
        ValueError: the episode is none of those that are predictable.
        UsageError: the search would need too much memory.
    """
    require_exact(episode)
    course = make_problem(episode)
    ticks = episode.scenario.ticks
    upper = (episode.scenario.eta_max if upper_bound is None else upper_bound) * (1.0 + TOLERANCE) + TOLERANCE
    moves = np.empty(ticks, np.int64)
    for histories, nodes, loose in _EFFORTS:
        reachability = make_reachability(histories, ticks)
        state, distance, gap, length = search_least(course, reachability, make_nodes(nodes), upper, loose, moves)
        if state not in (FULL, CROWDED):
            break
    if state == CROWDED:
        raise UsageError(f"margin: more than {histories} histories of the car in episode {episode.episode_id}")
    if state != FOUND:
        return None
    trajectory, duration, contact = _walk(episode, moves[:length])
    assert episode.safe_trajectory is not None
    exact = deviation(episode.safe_trajectory.positions, trajectory.positions, duration)
    assert abs(exact - distance) <= TOLERANCE, f"world {exact!r}, search {distance!r}"
    return Hit(exact, trajectory, duration, contact.speed, gap)


def _walk(episode: EpisodeSpec, moves: npt.NDArray[np.int64]) -> tuple[Trajectory, float, Contact]:
    """Return the trajectory of moves in the episode's own world, its duration in ticks, and the contact at its end.

    The last tick has to end in a hit, and none before in a collision: a search that found something else is wrong.
    """
    assert episode.safe_trajectory is not None
    scenario, path = episode.scenario, episode.safe_trajectory.positions
    world = make_world(episode)
    controller = BasicController(episode.multiplier)
    controller.reset(scenario, controller_generator(controller_seed(episode.seed, episode.episode_id)))
    walked = [world.adversary[:2]]
    contact = None
    for tick, move in enumerate(moves.tolist()):
        assert contact is None, f"episode {episode.episode_id}: collision in the world before tick {tick}"
        velocity = move_velocity(move, path, tick, scenario.time_step, scenario.adversary.speed)
        contact = world.step(controller.command(world.car, world.adversary), velocity)
        walked.append(world.adversary[:2])
    assert contact is not None, f"episode {episode.episode_id}: no collision in the world"
    assert scenario.collision.is_hit(contact.speed), f"episode {episode.episode_id}: no hit at {contact.speed!r} m/s"
    before, after = np.array(walked[-2]), np.array(walked[-1])
    walked[-1] = tuple(before + contact.fraction * (after - before))
    return Trajectory(np.array(walked), scenario.time_step), len(moves) - 1 + contact.fraction, contact


NOTHING, FOUND, FULL, CROWDED = range(4)
"""What a search answers: no hit within the limit, one found, no room for its nodes, or none for the histories."""
SAME = 1e-7  # m, between places that are one: sums of the same moves in another order
_SHIFT = 0.3819660112501051  # of the cells, so that no place of a simple φ is on a border
_SAME_MOVE = 1e-12  # m

_FIRST_LIMIT = 0.05  # m
_NEAR, _NEARER = 0.05, 0.001  # share of a limit to which the least that is possible is found
_NEAR_ENOUGH = 1e-4  # m
_WIDER, _MORE = 1.15, 0.03  # from what is possible to a limit within which something is likely found: a ratio, and m
_CELL, _CELL_SHARE = 0.02, 0.1  # m, and share of the limit: side of cells at first
_FINER, _TIMES = 0.4, 4  # from one side to the next, and how often
_WORTH = 5e-4  # share of the deviation: from one side to the next, for another
_LEAST_SHARE = 0.05  # of a gap: what is worth while to prove
_ENOUGH, _ENOUGH_SHARE = 1e-3, 0.002  # m, and share of the deviation: a gap that will do where there is no room
_FINE, _FINE_SHARE = 0.05, 0.1  # m, and share of the limit: parts of the car's motion in which contacts are looked at


class Nodes(NamedTuple):
    """Memory for the nodes of a search, layer by layer."""

    size: IntArray  # [nodes, layers so far]
    place: FloatArray  # node → x, y, m
    history: IntArray  # node → history of the reachability bound
    deviated: FloatArray  # node → greatest distance from φ so far, m
    origin: IntArray  # node → node before
    move: IntArray  # node → move that led here
    slot: IntArray  # hash table
    stamp: IntArray  # slot → layer that it is of


def make_nodes(capacity: int) -> Nodes:
    """Return memory for this many nodes, a power of two."""

    def integers() -> IntArray:
        return np.empty(capacity, np.int64)

    return Nodes(
        size=np.zeros(2, np.int64),
        place=np.empty((capacity, 2)),
        history=integers(),
        deviated=np.empty(capacity),
        origin=integers(),
        move=integers(),
        slot=np.empty(2 * capacity, np.int64),
        stamp=np.zeros(2 * capacity, np.int64),
    )


@kernel(inline=True)
def _hash(i: int, j: int, history: int, mask: int) -> int:
    mixed = (i * 0x9E3779B97F4A7C1) ^ (j * 0x5851F42D4C957F2D) ^ (history * 0x2545F4914F6CDD1D)
    mixed ^= (mixed >> 31) & 0x1FFFFFFFF
    mixed *= 0x369DEA0F31A53F85
    return ((mixed >> 32) ^ mixed) & mask


@kernel(inline=True)
def _visit(
    q: Nodes, x: float, y: float, history: int, deviated: float, origin: int, move: int, stamp: int, cell: float
) -> bool:
    """Add a node to a layer, unless the place was reached with less deviation; False: there is no room."""
    mask = q.slot.shape[0] - 1
    i, j = int(np.floor(x / cell + _SHIFT)), int(np.floor(y / cell + _SHIFT))
    slot = _hash(i, j, history, mask)
    while q.stamp[slot] == stamp:
        known = q.slot[slot]
        if (
            q.history[known] == history
            and int(np.floor(q.place[known, 0] / cell + _SHIFT)) == i
            and int(np.floor(q.place[known, 1] / cell + _SHIFT)) == j
        ):
            if deviated < q.deviated[known]:
                q.place[known, 0], q.place[known, 1] = x, y
                q.deviated[known] = deviated
                q.origin[known], q.move[known] = origin, move
            return True
        slot = (slot + 1) & mask
    node = q.size[0]
    if node >= q.history.shape[0]:
        return False
    q.size[0] = node + 1
    q.stamp[slot] = stamp
    q.slot[slot] = node
    q.place[node, 0], q.place[node, 1] = x, y
    q.history[node] = history
    q.deviated[node] = deviated
    q.origin[node] = origin
    q.move[node] = move
    return True


@kernel
def search_within(c: ExactProblem, f: Reachability, q: Nodes, limit: float, cell: float) -> tuple[int, int, int, float]:
    """Search for the hit of least deviation below a limit for which the reachability bound was made.

    Args:
        c: what is known of the episode beforehand.
        f: the reachability bound, with its sets.
        q: memory of the search.
        limit: only hits with less deviation than this are found, m.
        cell: side of the cells, m; in each cell the place with the least deviation stands for all. SAME: all places
            count.

    Returns:
        (FOUND, node before the last move, last move, deviation in m), or (NOTHING or FULL, −1, −1, infinity).
    """
    ticks = c.noise.shape[0]
    best, best_node, best_move = np.inf, -1, -1
    q.size[0] = 0
    q.size[1] += 1
    where = where_of(c, f, 0, c.path[0, 0], c.path[0, 1])
    if not is_hopeful(f, 0, where, c.path[0, 0], c.path[0, 1]):
        return NOTHING, -1, -1, np.inf
    _visit(q, c.path[0, 0], c.path[0, 1], 0, 0.0, -1, -1, q.size[1], cell)
    begin, end, tick = 0, 1, 0
    steps = np.empty((MOVE_COUNT, 2))
    names = np.empty(MOVE_COUNT, np.int64)
    side_apart = SURE * c.path_edge
    footprint = (c.front, c.rear, c.half_width)
    front_apart, rear_apart = SURE * (c.front + c.radius), SURE * (c.rear + c.radius)
    while begin < end and tick < ticks:
        q.size[1] += 1
        x_phi, y_phi = place_of_phi(c, tick)
        x_phi_to, y_phi_to = place_of_phi(c, tick + 1)
        distinct = 0
        for move in range(MOVE_COUNT):
            vx, vy = move_velocity(move, c.path, tick, c.time_step, c.adversary_speed)
            known = False
            for k in range(distinct):
                known |= max(abs(vx - steps[k, 0]), abs(vy - steps[k, 1])) * c.time_step <= _SAME_MOVE
            if not known:
                steps[distinct, 0], steps[distinct, 1], names[distinct] = vx, vy, move
                distinct += 1
        for node in range(begin, end):
            deviated = q.deviated[node]
            if deviated >= limit:
                continue
            history = q.history[node]
            x, y = q.place[node, 0], q.place[node, 1]
            where = where_of(c, f, history, x, y)
            after = f.child[history, where]
            if after < 0:
                continue
            goes_on = f.reached[after, 1] > 0
            car_x, car_y = f.car[history, 0], f.car[history, 1]
            car_x_to, car_y_to = f.car[after, 0], f.car[after, 1]
            speed, speed_after = f.car[history, 2], f.car[after, 2]
            dx, dy = x - car_x, y - car_y
            ahead, left = c.cos_heading * dx + c.sin_heading * dy, c.cos_heading * dy - c.sin_heading * dx
            for k in range(distinct):
                x_to, y_to = x + c.time_step * steps[k, 0], y + c.time_step * steps[k, 1]
                dx, dy = x_to - car_x_to, y_to - car_y_to
                ahead_to = c.cos_heading * dx + c.sin_heading * dy
                left_to = c.cos_heading * dy - c.sin_heading * dx
                if not (
                    min(left, left_to) > side_apart
                    or max(left, left_to) < -side_apart
                    or min(ahead, ahead_to) > front_apart
                    or max(ahead, ahead_to) < -rear_apart
                ):
                    fraction = first_contact((ahead, left), (ahead_to, left_to), footprint, c.radius)
                    if fraction <= 1.0:
                        impact = speed + fraction * (speed_after - speed)
                        if impact >= c.hit_speed:
                            away_x = x + fraction * (x_to - x) - (x_phi + fraction * (x_phi_to - x_phi))
                            away_y = y + fraction * (y_to - y) - (y_phi + fraction * (y_phi_to - y_phi))
                            distance = max(deviated, np.sqrt(away_x * away_x + away_y * away_y))
                            if distance < limit:
                                limit = best = distance
                                best_node, best_move = node, names[k]
                        if impact >= c.minimum_impact_speed:
                            continue
                if not goes_on or x_to > c.path_edge:
                    continue
                away_x, away_y = x_to - x_phi_to, y_to - y_phi_to
                distance = max(deviated, np.sqrt(away_x * away_x + away_y * away_y))
                if distance >= limit or not is_hopeful(f, after, where_of(c, f, after, x_to, y_to), x_to, y_to):
                    continue
                if not _visit(q, x_to, y_to, after, distance, node, names[k], q.size[1], cell):
                    return FULL, -1, -1, np.inf
        begin, end = end, q.size[0]
        tick += 1
    return (FOUND if best_node >= 0 else NOTHING), best_node, best_move, best


@kernel(inline=True)
def _fine(limit: float) -> float:
    return max(_FINE, _FINE_SHARE * limit)


@kernel
def _least_possible(c: ExactProblem, f: Reachability, low: float, high: float, share: float) -> float:
    """Return a limit near the greatest within which nothing can be reached; `low` is one, `high` is none."""
    while high - low > share * high + _NEAR_ENOUGH:
        middle = 0.5 * (low + high)
        if reach_forwards(c, f, middle, _fine(middle), True) == 0:
            low = middle
        else:
            high = middle
    return low


@kernel
def _search(
    c: ExactProblem, f: Reachability, q: Nodes, limit: float, cell: float, moves: IntArray
) -> tuple[int, float, int]:
    """Bound what a limit lets reach, and search within it; return what `search_least` does, but for the gap."""
    fine = _fine(limit)
    possible = reach_forwards(c, f, limit, fine, False)
    if possible == 0:
        return NOTHING, np.inf, 0
    if possible < 0 or reach_backwards(c, f, limit, fine) < 0:
        return CROWDED, np.inf, 0
    state, node, move, best = search_within(c, f, q, limit, cell)
    if state != FOUND:
        return state, np.inf, 0
    length = 1
    moves[0] = move
    while q.origin[node] >= 0:
        moves[length] = q.move[node]
        length += 1
        node = q.origin[node]
    moves[:length] = moves[:length][::-1].copy()
    return FOUND, best, length


@kernel(nogil=True)
def search_least(
    c: ExactProblem, f: Reachability, q: Nodes, upper: float, loose: bool, moves: IntArray
) -> tuple[int, float, float, int]:
    """Search for the hit of least deviation.

    First, by the reachability bound alone, a limit within which nothing is possible; then, in cells, a hit not far
    above; last all that there is below that. Where there is no room for all, finer cells and limits in
    between narrow the gap.

    Args:
        c: what is known of the episode beforehand.
        f: memory for the reachability bound.
        q: memory of the search.
        upper: only hits with less deviation than this are looked for, m.
        loose: whether a gap is accepted if there is no room for all nodes.
        moves: room for one move for each tick; receives those of the hit.

    Returns:
        (FOUND, deviation in m, by how much the least may be below it in m, number of moves), or (NOTHING, FULL or
        CROWDED, infinity, 0, 0).
    """
    fill_moves(c, f)
    low, high = 0.0, min(_FIRST_LIMIT, upper)
    while reach_forwards(c, f, high, _fine(high), True) == 0:
        low = high
        if high >= upper:
            return NOTHING, np.inf, 0.0, 0
        high = min(2.0 * high, upper)
    low = _least_possible(c, f, low, high, _NEAR)
    limit = low
    length, best, cell = 0, np.inf, _CELL
    while limit < upper:
        limit = min(_WIDER * limit + _MORE, upper)
        cell = max(_CELL, _CELL_SHARE * limit)
        state, best, length = _search(c, f, q, limit, cell, moves)
        while state == FULL and loose:
            cell *= 2.0
            state, best, length = _search(c, f, q, limit, cell, moves)
        if state in (FULL, CROWDED):
            return state, np.inf, 0.0, 0
        if state == FOUND:
            break
    other = np.empty_like(moves)
    limit = min(best, upper)
    if not loose:
        state, distance, other_length = _search(c, f, q, limit, SAME, other)
        if state == FOUND:
            moves[:] = other
            best, length = distance, other_length
        elif state != NOTHING:
            return state, np.inf, 0.0, 0
        return (FOUND if length > 0 else NOTHING), best, 0.0, length
    low = _least_possible(c, f, low, limit, _NEARER)
    for _ in range(_TIMES):  # more cells
        if limit - low <= _ENOUGH + _ENOUGH_SHARE * limit:
            break
        cell *= _FINER
        state, distance, other_length = _search(c, f, q, limit, cell, other)
        if state == FOUND:
            better = limit - distance
            moves[:] = other
            limit = best = distance
            length = other_length
            if better <= _WORTH * limit:
                break
        elif state != NOTHING:
            break
    share = 0.5
    for _ in range(_TIMES):  # all that there is, within less
        if (limit - low <= _ENOUGH + _ENOUGH_SHARE * limit and share < 1.0) or share < _LEAST_SHARE:
            break
        middle = low + share * (limit - low)
        state, distance, other_length = _search(c, f, q, middle, SAME, other)
        if state == FOUND:
            moves[:] = other
            limit = best = distance
            length = other_length
            low = max(low, limit)  # all that is less has been looked at
            break
        if state == NOTHING:
            low = middle
            if share == 1.0:
                break
            share = 1.0
        else:
            share *= 0.4 if share < 1.0 else 0.0
    if length == 0:  # there may be one near the bound
        return (NOTHING if low >= limit else FULL), np.inf, 0.0, 0
    return FOUND, best, max(0.0, best - low), length
