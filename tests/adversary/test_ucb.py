"""UCB1's constant where the search finds it itself."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from models import OPEN_LEFT, OPEN_RIGHT, tiger
from skd_adversary.pomdp.belief import ParticleBelief
from skd_adversary.pomdp.planner import Planner, PlannerOptions
from skd_adversary.pomdp.tree import FOUND, exploration_from, forget_returns, no_returns, note_return

RETURNS = st.lists(
    st.tuples(st.integers(0, 2), st.floats(-1e6, 1e6).map(lambda value: round(value, 3))), min_size=1, max_size=60
)


def _found(returns: Any, actions: int = 3) -> float:
    seen = no_returns(actions)
    seen[:] = 7.0  # of the decision before
    forget_returns(seen)
    for action, value in returns:
        note_return(seen, int(action), float(value))
    assert exploration_from(3.5, seen) == 3.5
    assert exploration_from(0.0, seen) == 0.0
    return float(exploration_from(FOUND, seen))


def test_it_is_twice_the_mean_absolute_deviation_of_an_action() -> None:
    """Of so many normal numbers that is 2 √(2/π) σ; the running mean costs O(ln n / n).

    That of the action counts whose returns deviate most, however seldom it was tried; one that was tried once has none.
    """
    rng, count = np.random.default_rng(1), 20_000
    often = [(0, value) for value in rng.normal(40.0, 3.0, count)]
    seldom = [(2, value) for value in rng.normal(-900.0, 5.0, count // 4)]
    expected = 2.0 * math.sqrt(2.0 / math.pi) * 5.0
    # The standard deviation of |x − μ| is σ √(1 − 2/π), and so many are seldom.
    error = 2.0 * 5.0 * math.sqrt((1.0 - 2.0 / math.pi) / len(seldom))
    assert _found([*often, *seldom, (1, 1e9)]) == pytest.approx(expected, abs=4.0 * error)


@given(returns=RETURNS, exponent=st.integers(-8, 8))
def test_it_has_the_unit_of_the_rewards(returns: list[tuple[int, float]], exponent: int) -> None:
    scale = 2.0**exponent
    if all(len({value for action, value in returns if action == own}) <= 1 for own in range(3)):
        assert _found(returns) == 1.0
    else:
        assert _found([(action, value * scale) for action, value in returns]) == _found(returns) * scale


@given(position=st.integers(0, 999))
def test_one_catastrophe_does_not_hide_the_rest(position: int) -> None:
    """The range of these returns is 1,000, twice their standard deviation 63; without the catastrophe 1.6 is found."""
    returns = np.random.default_rng(2).normal(size=1000)
    returns[position] = -1000.0
    # It leaves the running mean after j returns 1000/j too low: 1 + ln n more in the mean of n deviations, at most.
    most = 2.0 * (math.sqrt(2.0 / math.pi) + 1.0 + 1.0 + math.log(1000.0))
    assert 1.5 < _found([(0, value) for value in returns], 1) < most


def _decided(scale: float) -> Planner:
    model = tiger(listen=-scale, wrong=-100.0 * scale, right=10.0 * scale)
    rng = np.random.default_rng(3)
    planner = Planner(model, PlannerOptions(simulations=800, depth=8), rng)
    planner.plan(ParticleBelief(model, 200, rng))
    return planner


def test_rewards_in_another_unit_change_no_decision() -> None:
    """By a power of two, so that no number is rounded otherwise."""
    planner, other = _decided(1.0), _decided(1024.0)
    assert other.visits.tolist() == planner.visits.tolist()
    assert other.values.tolist() == (1024.0 * planner.values).tolist()
    assert other.exploration == 1024.0 * planner.exploration
    assert planner.visits.min() >= 1
    assert 1.0 < planner.exploration < 440.0  # no deviation is greater than the range, 110 at a step and the discount


def test_a_certain_catastrophe_is_not_tried_over_and_over() -> None:
    """It is known after a single try; the range of the returns as constant would try that door 7 times in 1,000."""
    model = tiger(wrong=-1000.0)
    rng = np.random.default_rng(5)
    planner, belief = Planner(model, PlannerOptions(simulations=1000, depth=1), rng), ParticleBelief(model, 400, rng)
    belief.particles[:, 0] = 1.0
    assert planner.plan(belief) == OPEN_LEFT
    assert planner.visits[OPEN_RIGHT] == 1
