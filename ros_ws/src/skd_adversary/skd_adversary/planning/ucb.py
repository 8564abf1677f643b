"""UCB1 (Auer, Cesa-Bianchi and Fischer, Machine Learning 47, 2002), and how many children an action may have.

UCB1's constant is in units of reward. Where none is given, it is the mean absolute deviation of the returns that this
decision's simulations had at the root, times `_DEVIATIONS`: what is to be told apart is the means of numbers that
scatter so much. The range of the returns would do as well, were it not for a single catastrophe, which hides all else;
so, for long, does the standard deviation.
"""

from __future__ import annotations

import functools
from typing import Final, NamedTuple

import numpy as np
from skd_sim.compilation import kernel

from skd_adversary.planning.pomdp import FloatArray
from skd_adversary.planning.search_tree import VALUE, VISITS, Float32Array, Int32Array, SearchTree

FOUND: Final = -1.0
"""Stands for an exploration that the search finds itself."""
_DEVIATIONS: Final = 2.0
RETURNS, MEAN, DEVIATIONS = range(3)
"""What is kept of a decision's returns: their number, mean, sum of absolute deviations from the mean so far."""
RETURN_STATISTICS: Final = 3


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
def forget_returns(seen: FloatArray) -> None:
    """Begin a decision."""
    for k in range(seen.shape[0]):
        seen[k] = 0.0


@kernel(inline=True)
def note_return(seen: FloatArray, value: float) -> None:
    """Note what a simulation returned at the root."""
    seen[RETURNS] += 1.0
    seen[MEAN] += (value - seen[MEAN]) / seen[RETURNS]
    seen[DEVIATIONS] += abs(value - seen[MEAN])


@kernel(inline=True)
def exploration_from(given: float, seen: FloatArray) -> float:
    """Return UCB1's constant: the given one, or, where that is `FOUND`, from the returns so far.

    While they are all the same any number serves, for all means are the same.
    """
    if given >= 0.0:
        return given
    return _DEVIATIONS * seen[DEVIATIONS] / seen[RETURNS] if seen[DEVIATIONS] > 0.0 else 1.0


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
