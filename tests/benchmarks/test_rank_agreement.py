"""Kendall's τ of two worlds: against scipy's, in its limits, and what its intervals say of data that are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rank_agreement import agreement, kendall_tau
from scipy import stats

few = st.integers(0, 6).map(float)  # few values, so that there are ties


@given(st.lists(st.tuples(few, few), min_size=2, max_size=12))
def test_tau_is_scipys(cars):
    first, second = np.array(cars).T
    expected = stats.kendalltau(first, second).statistic
    assert float(kendall_tau(first, second)) == pytest.approx(expected, nan_ok=True, abs=1e-12)


@given(st.lists(st.tuples(few, few, st.integers(0, 3)), min_size=2, max_size=8))
def test_a_car_that_counts_twice_is_two_cars_that_are_not_compared(cars):
    """So its weighted pairs are those of cars listed as often, less the pairs of a car with itself, which are ties."""
    first, second, often = np.array(cars).T
    listed = [np.repeat(row, often.astype(int)) for row in (first, second)]
    expected = float(kendall_tau(*listed)) if listed[0].size > 1 else float("nan")
    assert float(kendall_tau(first, second, often)) == pytest.approx(expected, nan_ok=True, abs=1e-12)


def world(means, phis=8, trials=4, spread=0.0, seed=0):
    rng = np.random.default_rng(seed)
    shift = spread * rng.standard_normal((len(means), phis, 1))
    return list(np.asarray(means)[:, None, None] + shift + 0.01 * rng.standard_normal((len(means), phis, trials)))


def test_worlds_that_agree_and_worlds_that_are_opposite():
    means = [0.1, 0.4, 0.9, 1.6, 2.5, 3.6]
    same = agreement(world(means), world([2.0 * mean for mean in means], seed=1))
    assert (same.cars, same.tau, same.by_phi, same.by_cars) == (6, 1.0, (1.0, 1.0), (1.0, 1.0))
    opposite = agreement(world(means), world(means[::-1], seed=1))
    assert (opposite.tau, opposite.by_phi) == (-1.0, (-1.0, -1.0))


def test_the_interval_over_phi_tells_whether_the_order_rests_on_a_few_of_them():
    means = np.linspace(0.0, 1.0, 6)
    clear = agreement(world(means, spread=0.05), world(means, spread=0.05, seed=1))
    noisy = agreement(world(means, spread=2.0), world(means, spread=2.0, seed=1))
    assert clear.by_phi[1] - clear.by_phi[0] < 0.2 < 0.6 < noisy.by_phi[1] - noisy.by_phi[0]


def test_the_interval_over_phi_holds_the_truth_as_often_as_it_says():
    """Six cars far apart but for two whose order in the second world is open: τ is 1 or 13/15, by chance of the φ."""
    means, held = [0.0, 1.0, 2.0, 3.0, 4.0, 4.05], 0
    for seed in range(100):
        found = agreement(world(means, 20, spread=0.1, seed=seed), world(means, 20, spread=0.1, seed=1000 + seed))
        held += found.by_phi[0] <= 1.0 <= found.by_phi[1]
    assert held >= stats.binom.ppf(1e-4, 100, 0.95)


def test_what_says_nothing_is_left_out():
    first, second = world([0.0, 1.0, 2.0]), world([0.0, 1.0, 2.0])
    second[1] = np.full_like(second[1], np.nan)
    assert agreement(first, second)[:2] == (2, 1.0)
    assert agreement(first[:1], second[:1]).by_cars is None
    with pytest.raises(ValueError, match="same cars and φ"):
        agreement(first, second[:2])
