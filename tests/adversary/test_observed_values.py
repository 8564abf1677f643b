"""Values of models whose state is seen, against exact solutions, and as leaves."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from models import OPEN_LEFT, OPEN_RIGHT, ring, tiger
from skd_adversary.planning.belief import ParticleBelief
from skd_adversary.planning.general.observed_values import (
    grid_index,
    observed_leaf_value,
    solve_observed,
    with_observed_leaves,
)
from skd_adversary.planning.options import PlannerOptions
from skd_adversary.planning.planner import Planner
from skd_sim.kernels.compilation import kernel

GAMMA = 0.95


def test_tiger_that_is_seen() -> None:
    """Open the right door for ever: 10 / (1 − γ), whichever it is."""
    solution = solve_observed(tiger(), ((0, 1),), samples=400, tolerance=1e-7)
    assert solution.values == pytest.approx([10.0 / (1.0 - GAMMA)] * 2, rel=1e-5)
    assert solution.action_values.argmax(axis=1).tolist() == [OPEN_RIGHT, OPEN_LEFT]


@kernel
def _walk(parameters: Any, state: Any, action: int, after: Any, rng: np.random.Generator) -> Any:
    """Go on by `action` cells with a probability, and be paid where it ends, in cell 0."""
    after[0] = state[0]
    if rng.random() < parameters.forward:
        after[0] = (state[0] + action) % parameters.cells
    return (10.0, True) if after[0] == 0.0 else (-1.0, False)


def test_random_steps_and_ends_against_an_exact_solution() -> None:
    model = replace(ring(cells=7, forward=0.7), name="test_observed_walk", step=_walk)
    values = np.zeros(7)
    for _ in range(500):
        q = np.empty((7, 4))
        for state in range(7):
            for action in range(4):
                outcomes = ((0.7, (state + action) % 7), (0.3, state))
                q[state, action] = sum(p * (10.0 if s == 0 else -1.0 + 0.9 * values[s]) for p, s in outcomes)
        values = q.max(axis=1)
    # A frequency of 20,000 draws is 0.003 off (σ), times what is at stake, at most 13, and what later steps add: 0.2.
    solution = solve_observed(model, ((0, 6),), samples=20_000, tolerance=1e-6)
    assert np.abs(solution.action_values - q).max() < 0.4
    assert solution.values == pytest.approx(solution.action_values.max(axis=1))


def test_states_are_found_again() -> None:
    lowest, sizes = np.array([-2, 1]), np.array([5, 3])
    states = [(float(a), float(b)) for a in range(-2, 3) for b in range(1, 4)]
    assert [grid_index(lowest, sizes, np.array(state)) for state in states] == list(range(15))
    for other in ((-3.0, 1.0), (3.0, 1.0), (0.0, 0.0), (0.0, 4.0), (0.5, 1.0)):
        assert grid_index(lowest, sizes, np.array(other)) < 0
    solution = solve_observed(ring(), ((0, 11),), samples=1)
    assert solution.index(np.array([[3.0], [11.0]])).tolist() == [3, 11]
    with pytest.raises(ValueError, match="outside the grid"):
        solution.index(np.array([[12.0]]))


def test_leaves_are_the_values_and_the_search_uses_them() -> None:
    """With a look-ahead of one step, the value of an action is its reward and the leaf's discounted value."""
    model = with_observed_leaves(tiger(), ((0, 1),), samples=400, tolerance=1e-7)
    assert observed_leaf_value(model.leaves, np.array([1.0])) == pytest.approx(200.0, rel=1e-5)
    assert observed_leaf_value(model.leaves, np.array([7.0])) == 0.0
    rng = np.random.default_rng(0)
    belief = ParticleBelief(model, 100, rng)
    belief.particles[:, 0] = 0.0
    planner = Planner(model, PlannerOptions(simulations=500, depth=1, exploration=50.0), rng)
    planner.plan(belief)
    assert planner.values == pytest.approx([189.0, 90.0, 200.0], rel=1e-4)


@pytest.mark.parametrize(
    ("ranges", "message"),
    [
        (((0, 1), (0, 1)), "test_tiger has states of 1 numbers"),
        (((1, 0),), "each needs a range"),
        (((0, 0),), r"a step of test_tiger from state \[0\] leads to none of the states .*: action [12] to \[1.0\]"),
    ],
)
def test_ranges_that_do_not_fit(ranges: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        solve_observed(tiger(), ranges)


def test_no_samples() -> None:
    with pytest.raises(ValueError, match="at least one sample"):
        solve_observed(tiger(), ((0, 1),), samples=0)


@kernel
def _not_around(parameters: Any, state: Any, action: int) -> bool:
    """Forbid to go past the last cell."""
    return action > 0 and state[0] + action <= parameters.cells


@kernel
def _nothing(parameters: Any, state: Any, action: int) -> bool:
    return False


@pytest.mark.parametrize(("legal", "expected"), [(_not_around, -1.0 + 0.9 * 10.0), (_nothing, 0.0)])
def test_what_is_not_legal_is_worth_nothing(legal: Any, expected: float) -> None:
    """From cell 3 of 7 the end, 4 cells on, is reached at once by 4; by 3 and 1 where at most 3 is possible."""
    model = replace(ring(cells=7, forward=1.0), name=f"test_observed{legal.__name__}", step=_walk, legal=legal)
    solution = solve_observed(model, ((0, 6),), samples=1)
    assert solution.values[3] == pytest.approx(expected)
    assert (solution.action_values[:, 0] == -np.inf).all()
    around = replace(model, name="test_observed_around", legal=None)
    # Cell 6 and 2 cells on: cell 1, in 8 − 7 steps; not to be done where it is forbidden to go around.
    assert np.isfinite(solve_observed(around, ((0, 6),), samples=1).action_values[6, 2])
    assert solution.action_values[6, 2] == -np.inf


def test_values_without_end() -> None:
    with pytest.raises(ValueError, match=r"test_tiger still change .* with a discount of 1 every episode has to end"):
        solve_observed(tiger(discount=1.0), ((0, 1),), samples=1, sweeps=100)


def test_too_many_states() -> None:
    with pytest.raises(ValueError, match=r"test_tiger has 1e\+12 states in these ranges, times 3 actions"):
        solve_observed(tiger(), ((1, 10**12),))
