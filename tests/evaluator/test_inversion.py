"""Intervals by inversion of a test, held against those that are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from skd_evaluator.risk.behaviour.fit import inverted

MIXED = np.array([[1.0, 0.0], [0.7, 1.0], [0.2, -1.0]])
QUANTILE = 1.959964


class Mixed:
    """Three numbers that two parameters are mixed into, with noise that grows with the first."""

    def __init__(self, wanted: np.ndarray, growth: float) -> None:
        self.observed, self._growth = wanted, growth
        self._noise = np.random.default_rng(3).standard_normal((20_000, 3))

    def allowed(self, free: np.ndarray) -> np.ndarray:
        return np.maximum(free, 0.0)

    def summary_at(self, free: np.ndarray) -> np.ndarray:
        return MIXED @ free

    def jacobian_at(self, free: np.ndarray) -> np.ndarray:
        return MIXED

    def groups_at(self, free: np.ndarray) -> np.ndarray:
        return MIXED @ free + (0.1 + self._growth * free[0]) * self._noise


@pytest.mark.parametrize(("first", "growth"), [(1.0, 0.0), (1.0, 0.3), (0.05, 0.0), (0.0, 0.3)])
def test_the_interval_is_the_one_in_closed_form(first, growth):
    """The estimate is x ± z·(a + g·θ)·c at a value θ: so the ends are (x ∓ z·a·c) / (1 ± z·g·c), and at least 0."""
    estimate = np.array([first, 2.0])
    unit = np.sqrt(np.linalg.inv(MIXED.T @ MIXED)[0, 0]) * QUANTILE
    low = max((first - 0.1 * unit) / (1.0 + growth * unit), 0.0)
    high = (first + 0.1 * unit) / (1.0 - growth * unit)
    problem = Mixed(MIXED @ estimate, growth)
    found = inverted(problem, estimate, 0, unit * (0.1 + growth * first) / QUANTILE, most=50.0)
    assert found == (pytest.approx(low, abs=0.03), pytest.approx(high, rel=0.06, abs=0.01))


def test_the_interval_ends_where_values_do():
    found = inverted(Mixed(MIXED @ np.array([1.0, 2.0]), 0.0), np.array([1.0, 2.0]), 0, 0.1, most=1.02)
    assert found[1] == pytest.approx(1.02, abs=1e-3)
