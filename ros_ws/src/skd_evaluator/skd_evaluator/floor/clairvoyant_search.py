"""Kernels behind the clairvoyant kamikaze: an exact search for the colliding action sequence that is nearest to φ.

The least Fréchet distance over all action sequences is a bottleneck path through the nodes (tick, lattice position, car
state, j): a coupling is part of the path, and a link costs |position − φ_j|. Sequences that meet in a position and a
car state at one tick are one node, which holds for every j the least longest link of a coupling that has come to φ_j;
what they do from then on is the same for all. A collision ends ψ at the place of contact, whose links are made then.
"""

from __future__ import annotations

import numpy as np
from skd_adversary.model.road_user.pedestrian import ACTION_COUNT, action_velocity
from skd_sim.arrays import FloatArray, IntArray
from skd_sim.controllers import basic_acceleration
from skd_sim.geometry.contact import first_contact
from skd_sim.kernels.compilation import kernel

from skd_evaluator.floor.clairvoyant_course import contact_bands, first_braking, last_contact_tick
from skd_evaluator.floor.clairvoyant_lattice import Lattice, count_to_go, spread
from skd_evaluator.floor.clairvoyant_tree import Tree, join, next_car, unseen
from skd_evaluator.margin.exact.course import MARGIN, SURE, Course

NOTHING, FOUND, FULL = range(3)
"""What a search answers: no such sequence, one found, or no room left in the workspace."""

_TIGHT = 1.0 - 1e-12  # squared links closer than this ratio differ by rounding only


@kernel
def _couple(before: FloatArray, links: FloatArray, out: FloatArray) -> None:
    """Write the least bottlenecks of couplings after one more point of ψ (squared; infinity: none)."""
    corner = flood = np.inf
    for j in range(before.shape[0]):
        least = min(before[j], corner, flood)
        corner = before[j]
        flood = max(least, links[j])
        out[j] = flood


@kernel
def _keep(out: FloatArray, to_go: IntArray, limit: float, left: int) -> bool:
    """Drop what is beyond the limit or cannot come to an end in time; return whether anything is left."""
    alive = False
    for j in range(out.shape[0]):
        if out[j] > limit or to_go[j] > left:
            out[j] = np.inf
        else:
            alive = True
    return alive


@kernel
def _apart(
    ahead: float, left: float, ahead_to: float, left_to: float, front: float, rear: float, side: float, radius: float
) -> bool:
    """Tell, without the swept test, that there is no contact: both ends are to one side of the car, well off."""
    return (
        min(left, left_to) > SURE * side
        or max(left, left_to) < -SURE * side
        or min(ahead, ahead_to) > SURE * (front + radius)
        or max(ahead, ahead_to) < -SURE * (rear + radius)
    )


@kernel
def _gone(c: Course, x: float, ahead: float, speed: float) -> bool:
    """Tell that the car cannot be touched any more by somebody behind its front bumper: it will have passed.

    It does not brake for who is behind its front, and at this speed or above nobody comes before it again. A contact
    needs |x| ≤ `path_edge`; all ticks but the last that it takes to get there are spent in full.

    Args:
        c: what is known of the episode beforehand.
        x: place of the adversary across the lane, m.
        ahead: how far the adversary is ahead of the car's reference point, m.
        speed: the least that the car will ever have if it is not braked, m/s.
    """
    if ahead >= c.front or speed < SURE * c.adversary_speed:
        return False
    step = c.time_step * c.adversary_speed
    ticks = max(0.0, np.ceil((-c.path_edge - MARGIN - x) / step) - 1.0)
    return ahead - ticks * (c.time_step * speed - step) < -SURE * (c.rear + c.radius)  # type: ignore[no-any-return]


@kernel
def _links(c: Course, x: float, y: float, out: FloatArray) -> None:
    for j in range(c.path.shape[0]):
        dx, dy = x - c.path[j, 0], y - c.path[j, 1]
        out[j] = dx * dx + dy * dy


@kernel
def _search_within(
    c: Course, lattice: Lattice, t: Tree, limit: float, touch: FloatArray
) -> tuple[int, int, int, float]:
    """Search for the best colliding sequence whose couplings need no link beyond the limit.

    Args:
        c: what is known of the episode beforehand.
        lattice: memory of the search: the places that can be reached.
        t: memory of the search: its tree.
        limit: limit on squared links, m².
        touch: room for n numbers; receives the squared links of the contact.

    Returns:
        (FOUND, last node, last action, squared distance), or (NOTHING or FULL, −1, −1, infinity).
    """
    ticks = c.noise.shape[0]
    last = c.path.shape[0] - 1
    places = spread(c, lattice, limit)
    if places < 0:
        return FULL, -1, -1, np.inf
    count_to_go(c, lattice, places, limit)
    bands = contact_bands(c, limit)
    braking_from = first_braking(c, limit)
    t.size[3] += 1
    search = t.size[3]
    fresh = np.empty(c.path.shape[0])
    links = np.empty(c.path.shape[0])
    t.car[0, 0], t.car[0, 1], t.car[0, 2] = c.car_x, c.car_y, c.car_speed
    t.child[0, :] = -1
    t.car_until[0] = last_contact_tick(c, bands, c.car_y, c.car_speed, 0, braking_from)
    fresh[:] = np.inf
    fresh[0] = 0.0  # the coupling begins with φ_0
    _couple(fresh, lattice.squared[0], t.reached[0])
    t.node_place[0], t.node_car[0], t.node_edge[0] = 0, 0, -1
    t.size[0], t.size[1], t.size[2] = 1, 1, 0
    best, best_node, best_action = np.inf, -1, -1
    begin, end = 0, 1
    if not _keep(t.reached[0], lattice.to_go[0], limit, t.car_until[0]):
        return NOTHING, -1, -1, np.inf
    for tick in range(ticks):
        t.size[3] += 1
        layer = t.size[3]
        t.size[4] += end - begin
        for node in range(begin, end):
            place, car = t.node_place[node], t.node_car[node]
            x, y = lattice.position[place, 0], lattice.position[place, 1]
            dx, dy = x - t.car[car, 0], y - t.car[car, 1]
            ahead, left = c.cos_heading * dx + c.sin_heading * dy, c.cos_heading * dy - c.sin_heading * dx
            braking = 1 if basic_acceleration(ahead - c.front, c.trigger, c.deceleration) != 0.0 else 0
            after = next_car(c, t, car, braking, tick)
            if after < 0:
                return FULL, -1, -1, np.inf
            x_car, y_car, speed_after = t.car[after, 0], t.car[after, 1], t.car[after, 2]
            if t.car_until[after] < 0:
                t.car_until[after] = last_contact_tick(c, bands, y_car, speed_after, tick + 1, braking_from)
            left_over = t.car_until[after] - tick - 1  # ticks
            speed = t.car[car, 2]
            for action in range(ACTION_COUNT):
                vx, vy = action_velocity(action, c.adversary_speed)
                x_to, y_to = x + c.time_step * vx, y + c.time_step * vy
                dx, dy = x_to - x_car, y_to - y_car
                ahead_to = c.cos_heading * dx + c.sin_heading * dy
                left_to = c.cos_heading * dy - c.sin_heading * dx
                fraction = np.inf
                if not _apart(ahead, left, ahead_to, left_to, c.front, c.rear, c.path_edge, c.radius):
                    fraction = first_contact(ahead, left, ahead_to, left_to, c.front, c.rear, c.half_width, c.radius)
                if fraction <= 1.0 and speed + fraction * (speed_after - speed) >= c.minimum_impact_speed:
                    _links(c, x + fraction * (x_to - x), y + fraction * (y_to - y), links)
                    if links[last] <= limit:
                        _couple(t.reached[node], links, fresh)
                        if fresh[last] <= limit:
                            best, best_node, best_action = fresh[last], node, action
                            touch[:] = links
                            limit = best * _TIGHT  # from here on only better ones matter
                    continue
                to = lattice.neighbour[place, action]
                if to < 0 or lattice.nearest[to] > left_over:
                    continue
                if _gone(c, x_to, ahead_to, speed_after * c.slowest[tick + 1]):
                    continue
                _couple(t.reached[node], lattice.squared[to], fresh)
                if not _keep(fresh, lattice.to_go[to], limit, left_over):
                    continue
                if t.size[1] >= t.node_car.shape[0]:
                    return FULL, -1, -1, np.inf
                if speed_after == 0.0 and (c.minimum_impact_speed > 0.0 or not unseen(t, to, after, fresh, search)):
                    continue
                if not join(t, to, after, fresh, node, action, layer):
                    return FULL, -1, -1, np.inf
        begin, end = end, t.size[1]
        if begin >= end:
            break
    return (FOUND if best_node >= 0 else NOTHING), best_node, best_action, best


@kernel
def _origin(before: FloatArray, links: FloatArray, j: int, limit: float) -> int:
    """Return which j at the point before a coupling within the limit comes from; −1: none."""
    while j >= 0 and links[j] <= limit:
        if before[j] <= limit:
            return j
        if j > 0 and before[j - 1] <= limit:
            return j - 1
        j -= 1
    return -1


@kernel
def _trace(
    c: Course, lattice: Lattice, t: Tree, node: int, action: int, limit: float, touch: FloatArray, actions: IntArray
) -> int:
    """Write the sequence that ends with `action` at `node`; return its length."""
    length = 1
    actions[0] = action
    j = _origin(t.reached[node], touch, c.path.shape[0] - 1, limit)
    while node != 0:
        edge = t.node_edge[node]
        while True:
            before = _origin(t.reached[t.edge_from[edge]], lattice.squared[t.node_place[node]], j, limit)
            if before >= 0:
                break
            edge = t.edge_next[edge]
        actions[length] = t.edge_action[edge]
        length += 1
        node, j = t.edge_from[edge], before
    actions[:length] = actions[:length][::-1].copy()
    return length


@kernel
def search_floor(c: Course, lattice: Lattice, t: Tree, upper: float, actions: IntArray) -> tuple[int, float, int]:
    """Search for the colliding sequence with the least discrete Fréchet distance from φ.

    Args:
        c: what is known of the episode beforehand.
        lattice: memory of the search: the places that can be reached.
        t: memory of the search: its tree.
        upper: only distances up to this are looked for, m; infinity: all.
        actions: room for one action per tick; receives the sequence.

    Returns:
        (FOUND, distance in m, number of actions), or (NOTHING or FULL, infinity, 0).
    """
    touch = np.empty(c.path.shape[0])
    lowest = max(0.0, abs(c.path[-1, 0]) - c.path_edge)
    step = 0.25 if upper == np.inf else np.inf
    rounds = 0
    while True:
        limit = min(upper, lowest + step)
        if rounds == 10:
            limit = upper
        state, node, action, best = _search_within(c, lattice, t, limit * limit, touch)
        if state == FULL:
            return FULL, np.inf, 0
        if state == FOUND:
            return FOUND, np.sqrt(best), _trace(c, lattice, t, node, action, best, touch, actions)
        if limit >= upper:
            return NOTHING, np.inf, 0
        step = 1.5 * step + 0.1
        rounds += 1
