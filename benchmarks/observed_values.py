"""The values of a model with few discrete states if its state could be seen: value iteration over all of them.

Such values are leaves for a search (Littman, Cassandra and Kaelbling 1995 act on them alone: QMDP). They are too high:
somebody who sees the state never has to pay for learning it. So a search that goes on from them must back up means, and
only what the tree itself finds out speaks for asking first.

The model's step can only be drawn from, so each state and action is tried a number of times, and the frequencies of
what follows stand for the probabilities.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from skd_adversary.pomdp.model import Pomdp
from skd_sim.arrays import FloatArray, IntArray
from skd_sim.kernels.compilation import bound, kernel, template, unbound

_CHUNK = 4096  # states whose outcomes are drawn at a time
_MOST = 10**8  # pairs of state and action: some gigabytes
_OUTSIDE = -2  # an outcome that is none of the states


_step = unbound


@kernel(inline=True)
def _any_action(_parameters: Any, _state: FloatArray, _action: int) -> bool:
    return True


_legal = _any_action


class StateGrid(NamedTuple):
    """A box of states of whole numbers, in row-major order: entry k runs from lowest[k], sizes[k] values."""

    lowest: IntArray
    sizes: IntArray


class ObservedLeaves(NamedTuple):
    """Values of all n states of a grid, as `observed_leaf_value` looks them up."""

    lowest: IntArray
    sizes: IntArray
    values: FloatArray  # n


@kernel(inline=True)
def grid_index(lowest: IntArray, sizes: IntArray, state: FloatArray) -> int:
    """Return the number of a state; negative where it is none of the grid's."""
    index = 0
    for k in range(sizes.shape[0]):
        entry = int(state[k]) - lowest[k]
        if entry < 0 or entry >= sizes[k] or state[k] != int(state[k]):
            return _OUTSIDE
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
    grid: StateGrid,
    begin: int,
    end: int,
    action_count: int,
    samples: int,
    rewards: FloatArray,
    rows: IntArray,
    successors: npt.NDArray[np.int32],
    chances: npt.NDArray[np.float32],
    rng: np.random.Generator,
) -> int:
    """Draw outcomes of all actions in the states from `begin` to `end`; return how many, or −1 − the state that fails.

    Rows are (state, action); of row r the successors are those from rows[r] to rows[r + 1]. An action that is not legal
    has none, and earns −∞.
    """
    state = np.empty(grid.sizes.shape[0])
    after = np.empty(grid.sizes.shape[0])
    count = 0
    for number in range(begin, end):
        rest = number
        for k in range(grid.sizes.shape[0] - 1, -1, -1):
            state[k] = grid.lowest[k] + rest % grid.sizes[k]
            rest //= grid.sizes[k]
        for action in range(action_count):
            row = (number - begin) * action_count + action
            rows[row] = count
            if not _legal(parameters, state, action):
                rewards[row] = -np.inf
                continue
            total = 0.0
            for _ in range(samples):
                reward, terminal = _step(parameters, state, action, after, rng)
                total += reward
                if terminal:
                    continue
                successor = grid_index(grid.lowest, grid.sizes, after)
                if successor < 0:
                    return -1 - number
                known = rows[row]
                while known < count and successors[known] != successor:
                    known += 1
                if known == count:
                    successors[known] = successor
                    chances[known] = 0.0
                    count += 1
                chances[known] += 1.0
            rewards[row] = total / samples
            for known in range(rows[row], count):
                chances[known] /= samples
    return count


@kernel
def _sweep(
    rewards: FloatArray,
    rows: IntArray,
    successors: npt.NDArray[np.int32],
    chances: npt.NDArray[np.float32],
    discount: float,
    values: FloatArray,
    action_values: FloatArray,
) -> float:
    """Improve the values in place (Gauss and Seidel); return the greatest change."""
    change = 0.0
    for state in range(action_values.shape[0]):
        best = -np.inf
        for action in range(action_values.shape[1]):
            row = state * action_values.shape[1] + action
            ahead = 0.0
            for k in range(rows[row], rows[row + 1]):
                ahead += chances[k] * values[successors[k]]
            action_values[state, action] = rewards[row] + discount * ahead
            best = max(best, action_values[state, action])
        if best == -np.inf:  # nothing is legal: such a state is none that is ever reached
            best = 0.0
        change = max(change, abs(best - values[state]))
        values[state] = best
    return change


@functools.cache
def _outcomes_kernel(name: str, step: Callable[..., Any], legal: Callable[..., Any] | None) -> Callable[..., Any]:
    parts = {"_step": step} if legal is None else {"_step": step, "_legal": legal}
    found: Callable[..., Any] = bound(_outcomes_template, name, parts)
    return found


@dataclass(frozen=True)
class ObservedSolution:
    """Values of a fully observed model.

    Attributes:
        grid: the grid of states.
        values: value of each state, in the grid's order.
        action_values: states × actions; −∞ where one is not legal.
    """

    grid: StateGrid
    values: FloatArray
    action_values: FloatArray

    def index(self, states: FloatArray) -> IntArray:
        """Return the row of each of n × d states."""
        entries = states.astype(np.int64) - self.grid.lowest
        if (entries < 0).any() or (entries >= self.grid.sizes).any():
            raise ValueError("a state lies outside the grid that was solved")
        rows: IntArray = np.ravel_multi_index(tuple(entries.T), tuple(self.grid.sizes.tolist()))
        return rows


def solve_observed(
    model: Pomdp,
    ranges: Sequence[tuple[int, int]],
    *,
    samples: int = 32,
    tolerance: float = 1e-3,
    sweeps: int = 10_000,
    seed: int = 0,
) -> ObservedSolution:
    """Solve the model as if its state were observed.

    Args:
        model: model whose states are vectors of whole numbers; its `step` must take any state that the ranges allow.
        ranges: lowest and highest value of each entry of a state.
        samples: draws of the step for each state and action: 1 where nothing is random. Fewer make the values too high.
        tolerance: greatest change of a value, in units of reward, that ends the iteration.
        sweeps: greatest number of sweeps; if the values have not settled by then, there is no solution.
        seed: seed of the random draws.

    Raises:
        ValueError: the ranges do not fit the model, a step leads out of them, there are too many states, or the values
            grow without end.
    """
    if len(ranges) != model.state_dim or any(low > high for low, high in ranges):
        raise ValueError(
            f"{model.name} has states of {model.state_dim} numbers, each needs a range (lowest, highest), got {ranges}"
        )
    if samples < 1:
        raise ValueError(f"each state needs at least one sample, got {samples}")
    grid = StateGrid(np.array([low for low, _ in ranges]), np.array([high - low + 1 for low, high in ranges]))
    total, actions = math.prod(grid.sizes.tolist()), model.action_count
    if total * actions > _MOST:
        raise ValueError(
            f"{model.name} has {total:.3g} states in these ranges, times {actions} actions: no more than "
            f"{_MOST:.0e} pairs of both can be solved"
        )
    draw = _outcomes_kernel(model.name, model.step, model.legal)
    rng = np.random.default_rng(seed)
    rewards, rows = np.empty(total * actions), np.empty(total * actions + 1, np.int64)
    successors = np.empty(_CHUNK * actions * samples, np.int32)
    chances = np.empty(_CHUNK * actions * samples, np.float32)
    parts: list[tuple[Any, Any]] = []
    found = 0
    for begin in range(0, total, _CHUNK):
        end = min(begin + _CHUNK, total)
        own = slice(begin * actions, end * actions)
        count = draw(
            model.parameters,
            grid,
            begin,
            end,
            actions,
            samples,
            rewards[own],
            rows[own],
            successors,
            chances,
            rng,
        )
        if count < 0:
            state = np.array(np.unravel_index(-1 - count, tuple(grid.sizes.tolist()))) + grid.lowest
            raise ValueError(
                f"a step of {model.name} from state {state.tolist()} leads to none of the states of {ranges}"
                + _way_out(model, grid, state.astype(float), samples, rng)
            )
        rows[own] += found
        found += count
        parts.append((successors[:count].copy(), chances[:count].copy()))
    rows[-1] = found
    followers, shares = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
    values, action_values = np.zeros(total), np.empty((total, actions))
    for _ in range(sweeps):
        if _sweep(rewards, rows, followers, shares, model.discount, values, action_values) <= tolerance:
            break
    else:
        raise ValueError(
            f"the values of {model.name} still change by more than {tolerance:g} after {sweeps:,} sweeps"
            + (": with a discount of 1 every episode has to end, whatever is done" if model.discount == 1.0 else "")
        )
    return ObservedSolution(grid, values, action_values)


def _way_out(model: Pomdp, grid: StateGrid, state: FloatArray, samples: int, rng: np.random.Generator) -> str:
    """Say which action leads from a state out of the grid, and where to; nothing if luck does not find it again."""
    after = np.empty(model.state_dim)
    for action in range(model.action_count):
        if model.legal is not None and not model.legal(model.parameters, state, action):
            continue
        for _ in range(samples):
            _, terminal = model.step(model.parameters, state, action, after, rng)
            if not terminal and grid_index(grid.lowest, grid.sizes, after) < 0:
                return f": action {action} to {after.tolist()}"
    return ""


def with_observed_leaves(model: Pomdp, ranges: Sequence[tuple[int, int]], **options: Any) -> Pomdp:
    """Return the model with the value of a leaf as if its state could be seen; see `solve_observed`."""
    solution = solve_observed(model, ranges, **options)
    return replace(
        model,
        leaf_value=observed_leaf_value,
        leaf_parameters=ObservedLeaves(*solution.grid, solution.values),
    )
