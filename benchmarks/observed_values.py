"""The values of a model with few discrete states if its state could be seen: value iteration over all of them.

Such values are leaves for a search (Littman, Cassandra and Kaelbling 1995 act on them alone: QMDP). They are too high:
somebody who sees the state never has to pay for learning it. So a search that goes on from them must back up means, and
only what the tree itself finds out speaks for asking first.

The model's step can only be drawn from, so each state and action is tried a number of times, and the frequencies of
what follows stand for the probabilities.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from skd_adversary.pomdp.model import Pomdp
from skd_sim.kernels.compilation import bound, kernel, template, unbound
from skd_sim.world.state import FloatArray, IntArray

_CHUNK = 4096  # states whose outcomes are drawn at a time
_SAMPLES = 32  # of the step, for each state and action
_TOLERANCE = 1e-3  # greatest change of a value, in units of reward, that ends the iteration
_step = unbound


class ObservedLeaves(NamedTuple):
    """Values of a box of states of whole numbers, in row-major order: entry k runs from lowest[k], sizes[k] values."""

    lowest: IntArray
    sizes: IntArray
    values: FloatArray


@kernel(inline=True)
def grid_index(lowest: IntArray, sizes: IntArray, state: FloatArray) -> int:
    """Return the number of a state; negative where it is none of the grid's."""
    index = 0
    for k in range(sizes.shape[0]):
        entry = int(state[k]) - lowest[k]
        if entry < 0 or entry >= sizes[k] or state[k] != int(state[k]):
            return -1
        index = index * sizes[k] + entry
    return index


@kernel(inline=True)
def observed_leaf_value(leaves: ObservedLeaves, state: FloatArray) -> float:
    """Return the value of a state of the grid; 0 of any other."""
    index = grid_index(leaves.lowest, leaves.sizes, state)
    return leaves.values[index] if index >= 0 else 0.0


@template(inline=False)
def _outcomes_template(
    parameters: Any,
    lowest: IntArray,
    sizes: IntArray,
    begin: int,
    rewards: FloatArray,
    rows: IntArray,
    successors: npt.NDArray[np.int32],
    chances: npt.NDArray[np.float32],
    rng: np.random.Generator,
) -> int:
    """Draw outcomes of all actions in the states from `begin` on; return how many, or −1 where one leads elsewhere.

    Rewards are states × actions, and rows number them; of row r the successors are those from rows[r] to rows[r + 1].
    """
    state, after = np.empty(sizes.shape[0]), np.empty(sizes.shape[0])
    count = 0
    for number in range(rewards.shape[0]):
        rest = begin + number
        for k in range(sizes.shape[0] - 1, -1, -1):
            state[k] = lowest[k] + rest % sizes[k]
            rest //= sizes[k]
        for action in range(rewards.shape[1]):
            first, total = count, 0.0
            rows[number * rewards.shape[1] + action] = first
            for _ in range(_SAMPLES):
                reward, terminal = _step(parameters, state, action, after, rng)
                total += reward
                if terminal:
                    continue
                successor = grid_index(lowest, sizes, after)
                if successor < 0:
                    return -1
                known = first
                while known < count and successors[known] != successor:
                    known += 1
                if known == count:
                    successors[known] = successor
                    chances[known] = 0.0
                    count += 1
                chances[known] += 1.0
            rewards[number, action] = total / _SAMPLES
            for known in range(first, count):
                chances[known] /= _SAMPLES
    return count


@kernel
def _sweep(
    rewards: FloatArray,
    rows: IntArray,
    successors: npt.NDArray[np.int32],
    chances: npt.NDArray[np.float32],
    discount: float,
    values: FloatArray,
) -> float:
    """Improve the values in place (Gauss and Seidel); return the greatest change."""
    change = 0.0
    for state in range(rewards.shape[0]):
        best = -np.inf
        for action in range(rewards.shape[1]):
            row = state * rewards.shape[1] + action
            ahead = 0.0
            for k in range(rows[row], rows[row + 1]):
                ahead += chances[k] * values[successors[k]]
            best = max(best, rewards[state, action] + discount * ahead)
        change = max(change, abs(best - values[state]))
        values[state] = best
    return change


def with_observed_leaves(model: Pomdp, ranges: Sequence[tuple[int, int]]) -> Pomdp:
    """Return the model with the value of a leaf as if its state could be seen.

    Args:
        model: its states are vectors of whole numbers; its `step` must take any state that the ranges allow.
        ranges: lowest and highest value of each entry of a state.

    Raises:
        ValueError: a step leads out of the ranges.
    """
    lowest, sizes = np.array([low for low, _ in ranges]), np.array([high - low + 1 for low, high in ranges])
    total, actions = math.prod(sizes.tolist()), model.action_count
    draw, rng = bound(_outcomes_template, model.name, {"_step": model.step}), np.random.default_rng(0)
    rewards, rows = np.empty((total, actions)), np.empty(total * actions + 1, np.int64)
    successors, chances = (np.empty(_CHUNK * actions * _SAMPLES, kind) for kind in (np.int32, np.float32))
    parts, found = [], 0
    for begin in range(0, total, _CHUNK):
        here = rewards[begin : begin + _CHUNK]
        numbers = rows[begin * actions :][: here.size]
        count = draw(model.parameters, lowest, sizes, begin, here, numbers, successors, chances, rng)
        if count < 0:
            raise ValueError(f"a step of {model.name} leads to none of the states of {ranges}")
        numbers += found
        found += count
        parts.append((successors[:count].copy(), chances[:count].copy()))
    rows[-1] = found
    followers, shares = (np.concatenate(each) for each in zip(*parts, strict=True))
    values = np.zeros(total)
    while _sweep(rewards, rows, followers, shares, model.discount, values) > _TOLERANCE:
        pass
    return replace(model, leaf_value=observed_leaf_value, leaf_parameters=ObservedLeaves(lowest, sizes, values))
