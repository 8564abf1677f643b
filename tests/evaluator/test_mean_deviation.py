from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from skd_evaluator.metrics.clustered import DISTANCES, clustered_mean
from skd_evaluator.metrics.deviation import MeanDeviation, mean_deviation


def of(distances: list[list[float]], failed: list[int], eta_max: float = 5.0) -> MeanDeviation:
    return mean_deviation(zip(map(np.array, distances), failed, strict=True), eta_max=eta_max)


def test_failed_trials_and_far_ones_count_as_eta_max() -> None:
    found = of([[0.5, 7.0], [1.5]], [1, 0])
    assert found.restricted.tolist() == [0.5, 5.0, 5.0, 1.5]
    assert (found.mean, found.trials) == (3.0, 4)
    assert found.of_successes == 3.0  # (0.5 + 7 + 1.5) / 3: what was needed, not what it counts as
    assert [entry.mean for entry in found.per_safe_trajectory] == [3.5, 1.5]
    assert [entry.mean_of_successes for entry in found.per_safe_trajectory] == [3.75, 1.5]
    low, high = found.ci95
    half = 1.959963984540054 * np.std([0.5, 5.0, 5.0, 1.5], ddof=1) / 2.0
    assert (low, high) == pytest.approx((3.0 - half, 3.0 + half))


def test_a_car_that_nobody_hits_has_the_greatest_there_is() -> None:
    found = of([[], []], [10, 10], eta_max=3.0)
    assert (found.mean, found.ci95, found.ci95_clustered) == (3.0, (3.0, 3.0), (3.0, 3.0))
    assert (found.of_successes, found.of_successes_ci95) == (None, None)


def test_without_a_trial_there_is_no_figure() -> None:
    found = of([[], []], [0, 0])
    assert (found.mean, found.ci95, found.ci95_clustered, found.of_successes) == (None, None, None, None)
    assert mean_deviation([], eta_max=5.0).mean is None


@given(
    st.lists(st.lists(st.floats(0.0, 9.0), max_size=6), min_size=1, max_size=4),
    st.lists(st.integers(0, 4), min_size=4, max_size=4),
    st.floats(0.1, 8.0),
)
def test_it_is_the_area_above_the_share_that_was_hit(
    distances: list[list[float]], failed: list[int], eta_max: float
) -> None:
    found = of(distances, failed[: len(distances)], eta_max)
    if not found.trials:
        assert found.mean is None
        return
    needed = np.concatenate([found.distances, np.full(found.trials - found.distances.size, np.inf)])
    steps = sorted({float(one) for one in found.distances if one < eta_max})
    area, _ = quad(lambda eta: 1.0 - np.mean(needed <= eta), 0.0, eta_max, points=steps or None, limit=200)
    assert found.mean == pytest.approx(area, abs=1e-6)
    assert 0.0 <= found.mean <= eta_max + 1e-12


def test_the_spread_between_trajectories_widens_the_clustered_interval() -> None:
    alike, apart = of([[1.0, 1.1, 1.9, 2.0]] * 6, [0] * 6), of([[1.0, 1.1] * 2] * 3 + [[1.9, 2.0] * 2] * 3, [0] * 6)
    assert alike.ci95 == pytest.approx(apart.ci95)  # the same values
    narrow, wide = (one.ci95_clustered[1] - one.ci95_clustered[0] for one in (alike, apart))
    assert wide > 1.3 * narrow


def test_the_interval_by_phi_allows_for_skewness_and_ends_where_deviations_do() -> None:
    groups = [(np.array([k, k * k / 3.0]), 0) for k in range(8)]
    found = mean_deviation(groups, eta_max=100.0)
    values = [entry.restricted for entry in found.per_safe_trajectory]
    assert found.clustered == clustered_mean(values, prior=DISTANCES, limits=(0.0, 100.0))
    few = mean_deviation(groups[::4], eta_max=5.0).ci95_clustered
    assert few == (0.0, 5.0)
