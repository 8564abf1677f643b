"""Rollouts that learn, by Q-learning in a table (Watkins and Dayan, Machine Learning 8, 1992).

A random walk hardly ever reaches its goal, so its return says nothing of the state in which it began. But the states of
many models come again, and the next rollout that meets one from which an earlier one succeeded may go on as that did.
The table holds the mean return of each action tried in a state, and is kept from decision to decision. So in time a
leaf is worth about what it were worth if its state were seen, without anybody's having solved the model.

States are told apart exactly. Where they do not come again, as with continuous numbers, that is noticed, and rollouts
are those of the default policy from then on.

So they are where the default policy is a sensible one, which may go by what the decision maker knows: what is learned
sees the state, and makes all delay look harmless. Before the first search the two are compared, from the same states:
what the default policy returns, what acting at random returns, and what has been learned. A default policy is sensible
if it is more than half-way from the second to the third.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel, specialise, unbound

from skd_adversary.pomdp.rollouts import no_note, roll_out_kernel, rollout_kernel
from skd_adversary.pomdp.search_tree import Float32Array, IndexArray, Int32Array

_rollout_action = _legal = _roll_out = _learning_rollout = _default_rollout = _random_rollout = unbound
_HAS_LEGAL = False
_PROBES: Final = 4  # places where a state may be
_LARGEST: Final = 2e9  # number that the digest tells from larger ones
_SCALE: Final = 3141592653.0  # not a power of two: whole numbers are to move all bits
_STRAY: Final = 0.1  # how often anything at all is done instead
_DOUBT: Final = 0.5  # how often the default policy is followed where all that was tried is worth less than usual
_LEAST_SHARE: Final = 0.125  # of a new return in a mean: old ones are those of a worse policy
_MEMORY: Final = 1000.0  # rollouts over which the usual return is a mean
_TRIAL: Final = 5000.0  # look-ups before it is judged whether states come again
_ENOUGH: Final = 0.01  # share of the look-ups that find their state, for learning to go on
_COMPARED: Final = 1000  # states, at most, from which the default policy is compared
_SENSIBLE: Final = 0.5  # of the way from acting at random to what is learned
_SURE: Final = 3.0  # standard errors that it is better than acting at random
USUAL, ROLLOUTS, SOUGHT, FOUND, IS_SENSIBLE = range(5)
"""Of `Experience.totals`: mean return of a rollout, rollouts made, look-ups, those that found their state; 1 where the
default policy is a sensible one."""


class Experience(NamedTuple):
    """Values of at most n states, and scratch memory for a rollout of h steps."""

    states: FloatArray  # n × s
    values: Float32Array  # n × a: mean return
    counts: Int32Array  # n × a: returns in that mean
    used: Int32Array  # n: rollout that met it last; 0: there is no state
    totals: FloatArray  # 5
    rows: Int32Array  # h: of the states met, −1: there was no room for it
    actions: Int32Array  # h
    rewards: FloatArray  # h


def no_experience(states: int, state_dim: int, actions: int, depth: int) -> Experience:
    """Return an empty table for so many states, made up to a power of two."""
    rows = 1 << max(states - 1, 0).bit_length()
    return Experience(
        states=np.zeros((rows, state_dim)),
        values=np.zeros((rows, actions), np.float32),
        counts=np.zeros((rows, actions), np.int32),
        used=np.zeros(rows, np.int32),
        totals=np.zeros(5),
        rows=np.zeros(depth, np.int32),
        actions=np.zeros(depth, np.int32),
        rewards=np.zeros(depth),
    )


@kernel(inline=True)
def first_place(table: Experience, state: FloatArray) -> int:
    """Return the first of the rows where a state may be."""
    digest = 0
    for k in range(state.shape[0]):
        # Kept within 62 bits, so that the arithmetic is the same whether or not integers wrap around.
        number = int(min(max(state[k], -_LARGEST), _LARGEST) * _SCALE) & 0xFFFFFFFF
        digest = ((digest ^ number) * 0x2545F491) & 0x3FFFFFFFFFFFFFFF
        digest ^= digest >> 29
    return int(digest & (table.used.shape[0] - 1))


@kernel(inline=True)
def row_of(table: Experience, state: FloatArray, now: int) -> int:
    """Return a state's row; if it has none, that of the state that was not met for longest; −1: all were met just now.

    Args:
        table: the table of rows.
        state: the state, s numbers.
        now: number of the rollout; those begin at 1.
    """
    place = first_place(table, state)
    oldest = -1
    table.totals[SOUGHT] += 1.0
    for probe in range(_PROBES):
        row = int((place + probe) & (table.used.shape[0] - 1))
        if table.used[row] > 0:
            same = True
            for k in range(state.shape[0]):
                if table.states[row, k] != state[k]:
                    same = False
                    break
            if same:
                table.totals[FOUND] += 1.0
                table.used[row] = now
                return row
        if table.used[row] < now and (oldest < 0 or table.used[row] < table.used[oldest]):
            oldest = row
    if oldest >= 0:
        table.used[oldest] = now
        for k in range(state.shape[0]):
            table.states[oldest, k] = state[k]
        for a in range(table.counts.shape[1]):
            table.counts[oldest, a] = 0
            table.values[oldest, a] = 0.0
    return oldest


@kernel(inline=True)
def best_tried(table: Experience, row: int) -> tuple[int, float]:
    """Return (action of greatest mean return, that return) of a row; (−1, −infinity) where none was tried."""
    action, best = -1, -np.inf
    for a in range(table.counts.shape[1]):
        if table.counts[row, a] > 0 and table.values[row, a] > best:
            action, best = a, float(table.values[row, a])
    return action, best


@kernel(inline=True)
def still_learns(table: Experience) -> bool:
    """Return whether states come again, as far as is known, and the default policy is none to keep to."""
    if table.totals[IS_SENSIBLE] > 0.0:
        return False
    return bool(table.totals[SOUGHT] < _TRIAL or table.totals[FOUND] >= _ENOUGH * table.totals[SOUGHT])


def _learning_act_template(
    parameters: Any, state: FloatArray, notes: tuple[Experience, int], made: int, rng: np.random.Generator
) -> int:
    """Choose by what is known of a state; notes are the table and the rollout's number, 0 where nothing is learned."""
    table, now = notes
    action, best, row = -1, -np.inf, -1
    if now > 0:
        row = row_of(table, state, now)
        if row >= 0:
            action, best = best_tried(table, row)
        draw = rng.random()
        if draw < _STRAY:
            action = int(table.counts.shape[1] * draw / _STRAY)
            if _HAS_LEGAL and not _legal(parameters, state, action):
                action = -1
        elif draw < _STRAY + (1.0 - _STRAY) * _DOUBT and best < table.totals[USUAL]:
            action = -1
    table.rows[made] = row
    if action < 0:
        action = _rollout_action(parameters, state, rng)
    return int(action)


@kernel(inline=True)
def _note(notes: tuple[Experience, int], made: int, action: int, reward: float) -> None:
    table, _ = notes
    table.actions[made], table.rewards[made] = action, reward


def _learning_rollout_template(
    parameters: Any,
    state: FloatArray,
    moved: FloatArray,
    table: Experience,
    steps: int,
    discount: float,
    rng: np.random.Generator,
) -> tuple[float, int, int, bool]:
    """Roll out from a state, which is overwritten, and learn from that.

    Returns:
        Value of the state, first action (−1 where `steps` is 0), steps made, whether the episode ended. The value is
        the greatest mean return of an action tried there; it reaches beyond `steps` where the last state has been met
        before.
    """
    if steps == 0:
        return 0.0, -1, 0, False
    totals = table.totals
    learns = still_learns(table)
    totals[ROLLOUTS] += 1.0
    now = int(totals[ROLLOUTS])
    value, first, made, terminal = _roll_out(
        parameters, state, moved, (table, now if learns else 0), steps, discount, rng
    )
    if not learns:
        return value, first, made, terminal
    totals[USUAL] += (value - totals[USUAL]) / min(totals[ROLLOUTS], _MEMORY)
    ahead = 0.0
    if not terminal:
        row = row_of(table, state if made % 2 == 0 else moved, now)
        if row >= 0:
            action, best = best_tried(table, row)
            if action >= 0:
                ahead = best
    for t in range(made - 1, -1, -1):
        ahead = table.rewards[t] + discount * ahead
        row, action = table.rows[t], table.actions[t]
        if row >= 0:
            table.counts[row, action] += 1
            share = np.float32(max(1.0 / table.counts[row, action], _LEAST_SHARE))
            table.values[row, action] += share * (np.float32(ahead) - table.values[row, action])
            _, ahead = best_tried(table, row)
    return ahead, first, made, terminal


def _random_act_template(parameters: Any, state: FloatArray, actions: int, made: int, rng: np.random.Generator) -> int:
    action = int(actions * rng.random())
    if _HAS_LEGAL:
        while not _legal(parameters, state, action):
            action = (action + 1) % actions
    return action


@kernel(inline=True)
def _begin(particles: FloatArray, source: int, state: FloatArray) -> None:
    for k in range(state.shape[0]):
        state[k] = particles[source, k]


def _practice_template(
    parameters: Any,
    particles: FloatArray,
    roots: IndexArray,
    state: FloatArray,
    moved: FloatArray,
    table: Experience,
    steps: int,
    discount: float,
    rng: np.random.Generator,
) -> int:
    """Learn from a rollout from each of the particles `roots`, as long as states come again; return the steps made.

    What has been learned is what the second half of these rollouts are worth.
    """
    count, actions = roots.shape[0], table.counts.shape[1]
    total, compared = 0, 0
    learned, at_random, gain, squares = 0.0, 0.0, 0.0, 0.0
    for i in range(count):
        if not still_learns(table):
            return total
        _begin(particles, roots[i], state)
        value, _, made, _ = _learning_rollout(parameters, state, moved, table, steps, discount, rng)
        total += made
        if i >= count // 2:
            learned += value / (count - count // 2)
        if i < _COMPARED:
            _begin(particles, roots[i], state)
            by_default, _, made, _ = _default_rollout(parameters, state, moved, None, steps, discount, rng)
            total += made
            _begin(particles, roots[i], state)
            anything, _, made, _ = _random_rollout(parameters, state, moved, actions, steps, discount, rng)
            total += made
            compared += 1
            at_random += (anything - at_random) / compared
            before = gain
            gain += (by_default - anything - gain) / compared
            squares += (by_default - anything - gain) * (by_default - anything - before)
    error = np.sqrt(squares / (compared * max(compared - 1, 1)))
    if gain > _SURE * error and gain > _SENSIBLE * (learned - at_random):
        table.totals[IS_SENSIBLE] = 1.0
    return total


@functools.cache
def learning_rollout_kernel(
    name: str,
    step: Callable[..., Any],
    rollout_action: Callable[..., Any],
    legal: Callable[..., Any] | None,
) -> Callable[..., Any]:
    """Return the kernel of a rollout that learns; see `_learning_rollout_template`."""
    own: dict[str, Any] = {"_rollout_action": rollout_action}
    own |= {} if legal is None else {"_legal": legal, "_HAS_LEGAL": True}
    act = specialise(_learning_act_template, name, own, inline=True)
    roll_out = roll_out_kernel(f"{name}__learning", step, act, _note)
    return specialise(_learning_rollout_template, name, {"_roll_out": roll_out}, inline=True)


@functools.cache
def practice_kernel(
    name: str,
    step: Callable[..., Any],
    rollout_action: Callable[..., Any],
    legal: Callable[..., Any] | None,
) -> Callable[..., Any]:
    """Return the kernel that learns before the first search; see `_practice_template`.

    Without it the first leaves would be worth what little is known then, and a mean forgets nothing.
    """
    own: dict[str, Any] = {} if legal is None else {"_legal": legal, "_HAS_LEGAL": True}
    act = specialise(_random_act_template, name, own, inline=True)
    bound = {
        "_learning_rollout": learning_rollout_kernel(name, step, rollout_action, legal),
        "_default_rollout": rollout_kernel(name, step, rollout_action),
        "_random_rollout": roll_out_kernel(f"{name}__anything", step, act, kernel(inline=True)(no_note)),
    }
    return specialise(_practice_template, name, bound, allocates=False)
