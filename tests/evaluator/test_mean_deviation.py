from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from skd_evaluator.metrics.clustered import DISTANCES, GroupedMean, clustered_mean
from skd_evaluator.metrics.deviation import mean_deviation


def of(distances: list[list[float]], failed: list[int], eta_max: float = 5.0) -> tuple[GroupedMean, GroupedMean]:
    return mean_deviation(zip(map(np.array, distances), failed, strict=True), eta_max=eta_max)


def test_failed_trials_and_far_ones_count_as_eta_max() -> None:
    every, hits = of([[0.5, 7.0], [1.5]], [1, 0])
    assert every.values.tolist() == [0.5, 5.0, 5.0, 1.5]
    assert (every.mean, every.means) == (3.0, [3.5, 1.5])
    assert (hits.mean, hits.means) == (3.0, [3.75, 1.5])  # (0.5 + 7 + 1.5) / 3: what was needed
    half = 1.959963984540054 * np.std([0.5, 5.0, 5.0, 1.5], ddof=1) / 2.0
    assert every.plain_interval == pytest.approx((3.0 - half, 3.0 + half))


def test_a_car_that_nobody_hits_has_the_greatest_there_is() -> None:
    every, hits = of([[], []], [10, 10], eta_max=3.0)
    assert (every.mean, every.plain_interval, every.interval) == (3.0, (3.0, 3.0), (3.0, 3.0))
    assert (hits.mean, hits.plain_interval) == (None, None)


def test_without_a_trial_there_is_no_figure() -> None:
    for part in (*of([[], []], [0, 0]), *mean_deviation([], eta_max=5.0)):
        assert (part.mean, part.plain_interval, part.interval) == (None, None, None)


@given(
    st.lists(st.lists(st.floats(0.0, 9.0), max_size=6), min_size=1, max_size=4),
    st.lists(st.integers(0, 4), min_size=4, max_size=4),
    st.floats(0.1, 8.0),
)
def test_it_is_the_area_above_the_share_that_was_hit(
    distances: list[list[float]], failed: list[int], eta_max: float
) -> None:
    every, hits = of(distances, failed[: len(distances)], eta_max)
    if every.mean is None:
        assert not every.values.size
        return
    needed = np.concatenate([hits.values, np.full(every.values.size - hits.values.size, np.inf)])
    steps = sorted({float(one) for one in hits.values if one < eta_max})
    area, _ = quad(lambda eta: 1.0 - np.mean(needed <= eta), 0.0, eta_max, points=steps or None, limit=200)
    assert every.mean == pytest.approx(area, abs=1e-6)
    assert 0.0 <= every.mean <= eta_max + 1e-12


def test_the_spread_between_trajectories_widens_the_clustered_interval() -> None:
    alike, _ = of([[1.0, 1.1, 1.9, 2.0]] * 6, [0] * 6)
    apart, _ = of([[1.0, 1.1] * 2] * 3 + [[1.9, 2.0] * 2] * 3, [0] * 6)
    assert alike.plain_interval == pytest.approx(apart.plain_interval)  # the same values
    narrow, wide = (one.interval[1] - one.interval[0] for one in (alike, apart))
    assert wide > 1.3 * narrow


def test_the_interval_by_phi_allows_for_skewness_and_ends_where_deviations_do() -> None:
    groups = [(np.array([k, k * k / 3.0]), 0) for k in range(8)]
    every, _ = mean_deviation(groups, eta_max=100.0)
    assert every.clustered == clustered_mean(every.groups, prior=DISTANCES, limits=(0.0, 100.0))
    assert mean_deviation(groups[::4], eta_max=5.0)[0].interval == (0.0, 5.0)
