from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from skd_evaluator.metrics.difference import Difference, difference

SEEDS = st.integers(0, 2**32)


@given(st.integers(2, 8), st.integers(1, 6), st.floats(0.5, 0.999), SEEDS)
def test_paired_with_equal_groups_is_the_paired_t_test(groups, values, confidence, seed):
    rng = np.random.default_rng(seed)
    first, second = rng.normal(size=(2, groups, values))
    found = difference(list(first), list(second), paired=True, confidence=confidence)
    theirs = stats.ttest_rel(second.mean(axis=1), first.mean(axis=1))
    interval = theirs.confidence_interval(confidence)
    assert found.interval == pytest.approx((interval.low, interval.high), rel=1e-6)
    assert found.p_value == pytest.approx(theirs.pvalue, rel=1e-6)
    assert found.direction == (np.sign(found.value) if theirs.pvalue < 1.0 - confidence else 0)


@given(st.integers(2, 8), st.integers(2, 8), st.integers(1, 6), SEEDS)
def test_apart_with_equal_groups_is_welchs_test(ours, theirs, values, seed):
    rng = np.random.default_rng(seed)
    first, second = rng.normal(size=(ours, values)), 3.0 * rng.normal(size=(theirs, values))
    found = difference(list(first), list(second), paired=False)
    welch = stats.ttest_ind(second.mean(axis=1), first.mean(axis=1), equal_var=False)
    assert found.p_value == pytest.approx(welch.pvalue, rel=1e-6)
    assert found.degrees_of_freedom == pytest.approx(welch.df, rel=1e-6)


def test_effect_size_is_in_deviations_within_a_phi():
    first, second = [[0.0, 2.0], [10.0, 12.0]], [[1.0, 3.0], [11.0, 13.0]]
    found = difference(first, second, paired=True)
    assert found.value == pytest.approx(1.0)
    assert found.effect_size == pytest.approx(1.0 / np.sqrt(2.0))  # variance 2 within each φ
    assert found.interval == pytest.approx((1.0, 1.0))  # the same for every φ, which is said
    assert "no width" in found.notes[1]
    assert found.p_value == 0.0


@pytest.mark.parametrize(
    ("value", "error", "leaning"),
    [(1.1, 2.0, 1), (1.0, 2.0, 0), (-1.0, 2.0, 0), (-1.1, 2.0, -1), (0.1, None, 1), (-0.1, None, -1), (0.0, None, 0)],
)
def test_it_points_one_way_beyond_half_a_standard_error(value, error, leaning):
    found = Difference(value, (value - 4.0, value + 4.0), 0.95, 0.5, error, 5.0, None, paired=True)
    assert found.leaning == leaning
    assert found.direction == 0


def test_too_few_or_none():
    one = difference([[1.0, 2.0]], [[2.0, 4.0]], paired=True)
    assert (one.value, one.interval, one.p_value, one.direction) == (1.5, None, None, 0)
    assert difference([[1.0], [2.0]], [[2.0]], paired=False).interval is None
    assert difference([[]], [[1.0]], paired=True) is None
    with pytest.raises(ValueError, match="do not pair"):
        difference([[1.0], [2.0]], [[1.0]], paired=True)
    same = difference([[1.0], [2.0]], [[1.0], [2.0]], paired=True)
    assert (same.interval, same.p_value, same.direction) == ((0.0, 0.0), 1.0, 0)
