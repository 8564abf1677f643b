"""UCB1 (Auer, Cesa-Bianchi and Fischer, Machine Learning 47, 2002), and how many children an action may have."""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
from skd_sim.compilation import kernel

from skd_adversary.planning.search_tree import VALUE, VISITS, Float32Array, Int32Array, SearchTree


class Tables(NamedTuple):
    """Functions of a number of visits, looked up rather than computed; the last entry stands for all beyond."""

    root_log: Float32Array  # √ln N
    inverse_root: Float32Array  # 1 / √N
    widening: Int32Array  # k·N^α, at least 1


@functools.cache
def tables_of(size: int, factor: float, exponent: float) -> Tables:
    """Return tables for trees of so many nodes."""
    count = np.maximum(np.arange(size), 1)
    widening = np.minimum(factor * count**exponent, np.iinfo(np.int32).max)
    return Tables(
        root_log=np.sqrt(np.log(count)).astype(np.float32),
        inverse_root=(1.0 / np.sqrt(count)).astype(np.float32),
        widening=np.maximum(widening, 1).astype(np.int32),
    )


@kernel(inline=True)
def choose(tree: SearchTree, node: int, exploration: float, tables: Tables, rng: np.random.Generator) -> int:
    """Return the action by UCB1; the untried come first, starting at a random one."""
    statistics = tree.statistics
    action_count = statistics.shape[1]
    last = tables.root_log.shape[0] - 1
    total = tree.total[node]
    scale = np.float32(exploration) * tables.root_log[min(total, last)]
    best = np.float32(-np.inf)
    action = 0
    untried = 0
    for a in range(action_count):
        count = int(statistics[node, a, VISITS])
        if count < 0:  # makes no sense here
            continue
        if count == 0:
            untried += 1
            continue
        score = statistics[node, a, VALUE] + scale * tables.inverse_root[min(count, last)]
        if score > best:
            best = score
            action = a
    if untried > 0:
        pick = int(rng.random() * untried)
        for a in range(action_count):
            if statistics[node, a, VISITS] == 0.0:
                if pick == 0:
                    return a
                pick -= 1
    return action
