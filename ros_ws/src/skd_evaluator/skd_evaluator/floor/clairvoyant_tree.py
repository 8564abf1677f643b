"""The tree that the search for the clairvoyant kamikaze grows: car states, nodes in layers, and edges between them.

A node is a lattice position with a car state at one tick. It holds for every j the least bottleneck of a coupling that
has come to φ_j, over all sequences that lead there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from skd_sim.arrays import FloatArray, IntArray
from skd_sim.kernels.compilation import kernel

from skd_evaluator.floor.clairvoyant_lattice import hash_of
from skd_evaluator.margin.exact.course import Course, car_step


class Tree(NamedTuple):
    """Memory for the nodes of a search; sizes are limits."""

    size: IntArray  # [cars, nodes, edges, stamp, expanded nodes of all searches]
    car: FloatArray  # id → x, y, m, and speed, m/s
    car_until: IntArray  # id → last tick, numbered from 1, in which it can be touched near enough to the end of φ
    child: IntArray  # id × (free, braking) → id at the next tick
    node_place: IntArray
    node_car: IntArray
    reached: FloatArray  # node × n: least squared bottleneck of a coupling that has come to φ_j
    node_edge: IntArray  # newest edge into the node
    edge_from: IntArray
    edge_action: IntArray
    edge_next: IntArray
    layer_slot: IntArray  # hash table of the layer being made
    layer_stamp: IntArray
    standing_slot: IntArray  # hash table: (position, standing car) → node whose `seen` holds the least so far
    standing_stamp: IntArray
    seen: FloatArray


def make_tree(points: int, capacity: int) -> Tree:
    """Return memory for φ of `points` points and `capacity` nodes (a power of two)."""

    def integers(*shape: int) -> IntArray:
        return np.empty(shape, np.int64)

    def zeros(*shape: int) -> IntArray:
        return np.zeros(shape, np.int64)

    cars = capacity // 4
    return Tree(
        size=zeros(5),
        car=np.empty((cars, 3)),
        car_until=integers(cars),
        child=integers(cars, 2),
        node_place=integers(capacity),
        node_car=integers(capacity),
        reached=np.empty((capacity, points)),
        node_edge=integers(capacity),
        edge_from=integers(2 * capacity),
        edge_action=integers(2 * capacity),
        edge_next=integers(2 * capacity),
        layer_slot=integers(2 * capacity),
        layer_stamp=zeros(2 * capacity),
        standing_slot=integers(2 * capacity),
        standing_stamp=zeros(2 * capacity),
        seen=np.empty((capacity, points)),
    )


@kernel
def next_car(c: Course, t: Tree, car: int, braking: int, tick: int) -> int:
    """Return the car's state one tick on, or −1: no room. A standing car stays the same state."""
    known = t.child[car, braking]
    if known >= 0:
        return known  # type: ignore[no-any-return]
    x, y, speed = t.car[car, 0], t.car[car, 1], t.car[car, 2]
    if speed == 0.0:
        t.child[car, braking] = car
        return car
    new = t.size[0]
    if new >= t.car.shape[0]:
        return -1
    t.size[0] = new + 1
    distance, speed_after = car_step(c, y, speed, braking != 0, tick)
    t.car[new, 0] = x + distance * c.cos_heading
    t.car[new, 1] = y + distance * c.sin_heading
    t.car[new, 2] = speed_after
    t.car_until[new] = -1
    t.child[new, :] = -1
    t.child[car, braking] = new
    return new  # type: ignore[no-any-return]


@kernel
def unseen(t: Tree, place: int, car: int, fresh: FloatArray, stamp: int) -> bool:
    """Keep in `fresh` what is less than ever before beside a standing car; return whether any is left.

    Beside a car that stands for good, coming to the same later is of no use.
    """
    mask = t.standing_slot.shape[0] - 1
    slot = hash_of((car << 32) | place, mask)
    while t.standing_stamp[slot] == stamp:
        entry = t.standing_slot[slot]
        if t.node_place[entry] == place and t.node_car[entry] == car:
            alive = False
            for j in range(fresh.shape[0]):
                if fresh[j] < t.seen[entry, j]:
                    t.seen[entry, j] = fresh[j]
                    alive = True
                else:
                    fresh[j] = np.inf
            return alive
        slot = (slot + 1) & mask
    entry = t.size[1]  # the node that is about to be made for it
    t.standing_stamp[slot] = stamp
    t.standing_slot[slot] = entry
    t.seen[entry, :] = fresh
    return True


@kernel
def join(t: Tree, place: int, car: int, fresh: FloatArray, origin: int, action: int, stamp: int) -> bool:
    """Add what has been reached to the layer being made; return False where there is no room."""
    mask = t.layer_slot.shape[0] - 1
    slot = hash_of((car << 32) | place, mask)
    node = -1
    while t.layer_stamp[slot] == stamp:
        entry = t.layer_slot[slot]
        if t.node_place[entry] == place and t.node_car[entry] == car:
            node = entry
            break
        slot = (slot + 1) & mask
    if node < 0:
        node = t.size[1]
        t.size[1] = node + 1
        t.layer_stamp[slot] = stamp
        t.layer_slot[slot] = node
        t.node_place[node] = place
        t.node_car[node] = car
        t.reached[node, :] = fresh
        t.node_edge[node] = -1
    else:
        new = False
        for j in range(fresh.shape[0]):
            if fresh[j] < t.reached[node, j]:
                t.reached[node, j] = fresh[j]
                new = True
        if not new:
            return True
    edge = t.size[2]
    if edge >= t.edge_from.shape[0]:
        return False
    t.size[2] = edge + 1
    t.edge_from[edge] = origin
    t.edge_action[edge] = action
    t.edge_next[edge] = t.node_edge[node]
    t.node_edge[node] = edge
    return True
