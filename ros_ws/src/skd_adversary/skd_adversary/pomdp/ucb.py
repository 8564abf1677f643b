"""UCB1 (Auer, Cesa-Bianchi and Fischer, Machine Learning 47, 2002), and how many children an action may have.

UCB1's constant is in units of reward. Where none is given, it is `_DEVIATIONS` times the mean absolute deviation of
what an action of the root returned in this decision, of the action for which that is greatest. Every action counts,
however seldom it is tried: else a search that settles on an action whose return is certain would find ever less reason
to try others. What sets actions apart counts for nothing, so one that is always a catastrophe does not hide what the
others are worth, as it would in the range of the returns. A catastrophe that seldom happens counts with its share, of
which a standard deviation would take the root.
"""

from __future__ import annotations

import functools
from typing import Final, NamedTuple

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel

from skd_adversary.pomdp.search_tree import VALUE, VISITS, Float32Array, Int32Array, SearchTree

FOUND: Final = -1.0
"""Stands for an exploration that the search finds itself."""
_DEVIATIONS: Final = 2.0
RETURNS, MEAN, DEVIATIONS = range(3)
"""What is kept of an action's returns: their number, mean, sum of absolute deviations from the mean so far."""


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


def no_returns(actions: int) -> FloatArray:
    """Return the array (actions × 3) that the kernels below keep; see `RETURNS`."""
    return np.zeros((actions, 3))


@kernel(inline=True)
def forget_returns(seen: FloatArray) -> None:
    """Begin a decision."""
    for action in range(seen.shape[0]):
        for k in range(seen.shape[1]):
            seen[action, k] = 0.0


@kernel(inline=True)
def note_return(seen: FloatArray, action: int, value: float) -> None:
    """Note what a simulation returned at the root, and which action it began with."""
    seen[action, RETURNS] += 1.0
    seen[action, MEAN] += (value - seen[action, MEAN]) / seen[action, RETURNS]
    seen[action, DEVIATIONS] += abs(value - seen[action, MEAN])


@kernel(inline=True)
def exploration_from(given: float, seen: FloatArray) -> float:
    """Return UCB1's constant: the given one, or, where that is `FOUND`, from the returns so far.

    It is 1 while no action has returned two different numbers.
    """
    if given >= 0.0:
        return given
    most = 0.0
    for action in range(seen.shape[0]):
        if seen[action, RETURNS] > 0.0:
            most = max(most, seen[action, DEVIATIONS] / seen[action, RETURNS])
    return _DEVIATIONS * most if most > 0.0 else 1.0


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
    for a in range(action_count):  # without branches: which actions were tried, and which is best, is no pattern
        count = int(statistics[node, a, VISITS])  # negative: makes no sense here
        untried += 1 if count == 0 else 0
        score = statistics[node, a, VALUE] + scale * tables.inverse_root[max(0, min(count, last))]  # −∞: not tried
        action = a if score > best else action
        best = score if score > best else best
    if untried > 0:
        pick = int(rng.random() * untried)
        for a in range(action_count):
            if statistics[node, a, VISITS] == 0.0:
                if pick == 0:
                    return a
                pick -= 1
    return action
