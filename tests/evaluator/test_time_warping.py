"""Dynamic time warping against the definition: every coupling there is, weighed and added up."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from skd_evaluator.metrics.frechet import warped_distance

Coupling = tuple[tuple[int, int], ...]
CURVES = st.integers(1, 5).flatmap(
    lambda count: arrays.arrays(np.float64, (count, 2), elements=st.floats(-10.0, 10.0, width=32))
)


def couplings(n: int, m: int) -> Iterator[Coupling]:
    """Every way from the first points to the last by steps in one, in the other or in both."""
    if (n, m) == (1, 1):
        yield ((0, 0),)
    for di, dj in ((1, 0), (0, 1), (1, 1)):
        if n - di >= 1 and m - dj >= 1:
            for before in couplings(n - di, m - dj):
                yield (*before, (n - 1, m - 1))


def by_definition(phi: np.ndarray, psi: np.ndarray) -> float:
    sums = []
    for coupling in couplings(len(phi), len(psi)):
        previous = (-1, -1)
        total = 0.0
        for i, j in coupling:
            weight = (i - previous[0]) + (j - previous[1])
            total += weight * float(np.linalg.norm(phi[i] - psi[j]))
            previous = (i, j)
        sums.append(total)
    return min(sums) / (len(phi) + len(psi))


@settings(max_examples=150, deadline=None)
@given(CURVES, CURVES)
def test_it_is_the_least_over_all_couplings(phi: np.ndarray, psi: np.ndarray):
    found = warped_distance(phi, psi)
    assert found == pytest.approx(by_definition(phi, psi), rel=1e-12, abs=1e-12)
    assert found == pytest.approx(warped_distance(psi, phi), rel=1e-12, abs=1e-12)
    assert warped_distance(phi, phi) == 0.0


def test_waiting_costs_nothing_and_a_shift_is_its_length():
    line = np.column_stack([np.linspace(0.0, 5.0, 6), np.zeros(6)])
    assert warped_distance(line, np.repeat(line, 3, axis=0)) == 0.0
    assert warped_distance(line, line + np.array([0.0, 0.25])) == pytest.approx(0.25, rel=1e-12)
