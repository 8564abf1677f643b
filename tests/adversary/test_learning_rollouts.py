"""What rollouts learn, against the values of the fully observed problem; and the table that they learn in."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from skd_adversary.pomdp.learning_rollouts import (
    FOUND,
    IS_SENSIBLE,
    ROLLOUTS,
    SOUGHT,
    Experience,
    best_tried,
    learning_rollout_kernel,
    no_experience,
    practice_kernel,
    row_of,
)
from skd_adversary.pomdp.options import PlannerOptions
from skd_adversary.pomdp.pomdp import Pomdp
from skd_sim.kernels.compilation import kernel

LEFT, RIGHT, JUMP = range(3)
CELLS, FALL = 12, 5


class Corridor(NamedTuple):
    """Cells 0 … 11, a prize of 10 beyond the last; a step slips with this probability, a jump falls for 5."""

    slip: float = 0.2
    drift: float = 0.0  # σ of what is added to a number that means nothing, so that no state comes again


@kernel
def corridor_initial(p: Corridor, state: Any, rng: np.random.Generator) -> None:
    state[0] = math.floor(CELLS * rng.random())
    state[1] = 0.0


@kernel
def corridor_step(p: Corridor, state: Any, action: int, after: Any, rng: np.random.Generator) -> Any:
    after[0], after[1] = state[0], p.drift * rng.standard_normal() if p.drift > 0.0 else 0.0
    if action == JUMP:
        return -5.0, True
    if rng.random() >= p.slip:
        after[0] = max(state[0] + (1.0 if action == RIGHT else -1.0), 0.0)
    if after[0] >= CELLS:
        after[0] = CELLS - 1
        return 10.0, True
    return 0.0, False


@kernel
def corridor_observe(p: Corridor, state: Any, action: int, seen: Any, rng: np.random.Generator) -> None:
    seen[0] = 0.0


@kernel
def corridor_likelihood(p: Corridor, state: Any, action: int, seen: Any) -> float:
    return 1.0


@kernel
def anything(p: Corridor, state: Any, rng: np.random.Generator) -> int:
    return int(3.0 * rng.random())


@kernel
def go_left(p: Corridor, state: Any, rng: np.random.Generator) -> int:
    return LEFT


@kernel
def go_right(p: Corridor, state: Any, rng: np.random.Generator) -> int:
    return RIGHT


@kernel
def no_jump(p: Corridor, state: Any, action: int) -> bool:
    return action != JUMP


@kernel
def corridor_redraw(p: Corridor, state: Any, seen: Any, redrawn: Any, rng: np.random.Generator) -> None:
    redrawn[:] = state


CORRIDOR = Pomdp(
    "test_corridor",
    2,
    1,
    3,
    0.9,
    Corridor(),
    corridor_initial,
    corridor_step,
    corridor_observe,
    corridor_likelihood,
    anything,
    corridor_redraw,
)
STEPS = 60


@functools.cache
def _of_the_corridor(default: Any) -> tuple[Experience, list[Any]]:
    return _roll_out(replace(CORRIDOR, rollout_action=default), f"corridor_{default.__name__}", 2500)


def _roll_out(model: Pomdp, name: str, count: int, states: int = 64, legal: Any = None) -> tuple[Experience, list[Any]]:
    """Roll out `count` times from states drawn at random; return the table and what each rollout returned."""
    rollout = learning_rollout_kernel(name, model.step, model.rollout_action, legal)
    rng = np.random.default_rng(4)
    table = no_experience(states, model.state_dim, model.action_count, STEPS)
    state, moved = np.empty(model.state_dim), np.empty(model.state_dim)
    results = []
    for _ in range(count):
        model.initial(model.parameters, state, rng)
        start = state.tolist()
        value, first, made, _ = rollout(model.parameters, state, moved, table, STEPS, model.discount, rng)
        results.append((start, value, first, made))
    return table, results


def _row(table: Experience, state: list[float]) -> int:
    (rows,) = np.nonzero((table.states == state).all(axis=1) & (table.used > 0))
    assert len(rows) == 1
    return int(rows[0])


@pytest.mark.parametrize("default", [anything, go_left])
def test_values_of_states_are_those_of_the_fully_observed_problem(default: Any) -> None:
    """Also where the default policy goes the wrong way, for one action in ten is anything."""
    table, _ = _of_the_corridor(default)
    # To the right with 0.8, else to stay: v = γ(0.8 v' + 0.2 v), and 8 + 0.2 γ v in the last cell.
    exact = [8.0 / 0.82 * (0.72 / 0.82) ** (CELLS - 1 - cell) for cell in range(CELLS)]
    for cell in range(CELLS):
        action, value = best_tried(table, _row(table, [cell, 0.0]))
        assert action == RIGHT
        # One step's luck is worth 10 · (1 − γ) · √(0.2 · 0.8) = 0.4 at most, and a mean over 8 keeps an eighth of its
        # variance at each of the steps ahead: √(12 / 15) · 0.4 = 0.36.
        assert abs(value - exact[cell]) <= 4.5 * 0.36


def test_a_rollout_goes_by_what_was_learned() -> None:
    _, results = _of_the_corridor(anything)
    early, late = ([first == RIGHT for _, _, first, _ in part] for part in (results[:100], results[-1000:]))
    assert np.mean(early) < 0.75
    # 1 − 0.1 · 2/3, less what is done by default where the value is below the usual one: in at most all cells, half.
    assert np.mean(late) > 0.6


def test_a_rollout_returns_what_its_first_state_is_worth_by_then() -> None:
    for count in (1, 2, 30, 200):
        table, results = _roll_out(CORRIDOR, "corridor_anything", count)
        start, value, first, made = results[-1]
        row = _row(table, start)
        assert value == best_tried(table, row)[1]
        assert table.counts[row, first] > 0
        assert table.totals[ROLLOUTS] == count
        assert 1 <= made <= STEPS
    # The first rollout of all, in which no action was tried twice in a state: what it is worth is what it gained.
    _, [(_, value, _, made)] = _roll_out(CORRIDOR, "corridor_anything", 1)
    assert value in (pytest.approx(-5.0 * 0.9 ** (made - 1)), pytest.approx(10.0 * 0.9 ** (made - 1)))


def test_illegal_actions_are_never_tried() -> None:
    model = replace(CORRIDOR, rollout_action=go_left)
    table, _ = _roll_out(model, "corridor_legal", 300, legal=no_jump)
    assert table.counts[:, RIGHT].sum() > 0
    assert (table.counts[:, JUMP] == 0).all()


def test_states_that_do_not_come_again_are_left_to_the_default_policy() -> None:
    """Then the values are its returns, −5 · γ^n or 0, and nothing is looked up any more."""
    model = replace(CORRIDOR, rollout_action=go_left, parameters=Corridor(drift=1.0))
    table, results = _roll_out(model, "corridor_left_drifting", 400)
    assert 5000 <= table.totals[SOUGHT] <= 5000 + STEPS + 1
    assert table.totals[FOUND] < 0.01 * table.totals[SOUGHT]
    assert {result[1:] for result in results[-200:]} == {(0.0, LEFT, STEPS)}


def test_without_steps_nothing_is_learned() -> None:
    rollout = learning_rollout_kernel("corridor_anything", CORRIDOR.step, anything, None)
    table = no_experience(4, 2, 3, 5)
    rng = np.random.default_rng(1)
    assert rollout(CORRIDOR.parameters, np.zeros(2), np.zeros(2), table, 0, 0.9, rng) == (0.0, -1, 0, False)
    assert rng.random() == np.random.default_rng(1).random()
    assert not table.totals.any()


@given(data=st.data(), rows=st.sampled_from([1, 2, 8, 64]))
def test_a_state_is_found_until_its_row_is_given_to_another(data: st.DataObject, rows: int) -> None:
    """Whatever is in the table, a row holds the state that it was last handed out for, with what was kept there."""
    table = no_experience(rows, 1, 1, 1)
    owner: dict[int, float] = {}
    marks: dict[int, int] = {}
    numbers = st.one_of(st.integers(-9, 9).map(float), st.sampled_from([0.1, -1e300, 1e300, 2.0**-30, 3e9, 4e9]))
    for now, number in enumerate(data.draw(st.lists(numbers, max_size=40)), start=1):
        row = row_of(table, np.array([number]), now)
        assert 0 <= row < rows
        if owner.get(row) == number:
            assert table.counts[row, 0] == marks[row]
        else:
            assert number not in owner.values()
            assert table.counts[row, 0] == 0
        owner[row], marks[row] = number, now
        table.counts[row, 0] = now
    assert len(owner) == (table.used > 0).sum()


def test_the_best_of_what_was_tried() -> None:
    table = no_experience(1, 1, 3, 1)
    assert best_tried(table, 0) == (-1, -np.inf)
    table.values[0] = [0.0, -2.0, -1.0]
    table.counts[0] = [0, 1, 4]
    assert best_tried(table, 0) == (2, -1.0)


def test_a_negative_number_of_states() -> None:
    with pytest.raises(ValueError, match="learned_states must not be negative, got -1"):
        PlannerOptions(learned_states=-1)


@pytest.mark.parametrize(("default", "sensible"), [(go_right, True), (anything, False), (go_left, False)])
def test_a_sensible_default_policy_is_kept_to(default: Any, sensible: bool) -> None:
    """To go right is the best there is, worth 5.3 on average, by value iteration, too; doing anything is worth −3.6.

    To go left is worth 0: better than anything, but not by half.
    """
    practise = practice_kernel(f"corridor_{default.__name__}", CORRIDOR.step, default, None)
    rng = np.random.default_rng(8)
    table = no_experience(64, 2, 3, STEPS)
    particles = np.array([[cell, 0.0] for cell in range(CELLS)])
    roots = np.arange(12_000, dtype=np.int32) % CELLS
    made = practise(CORRIDOR.parameters, particles, roots, np.empty(2), np.empty(2), table, STEPS, 0.9, rng)
    assert made > len(roots)
    assert bool(table.totals[IS_SENSIBLE]) == sensible
    assert table.totals[ROLLOUTS] == len(roots)
    again = practise(CORRIDOR.parameters, particles, roots, np.empty(2), np.empty(2), table, STEPS, 0.9, rng)
    assert (again == 0) == sensible
