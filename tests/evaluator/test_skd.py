import math

import numpy as np
import pytest
from scipy import stats
from skd_evaluator.metrics.skd import bound_interval, compute_skd
from skd_evaluator.metrics.statistics import frechet_probability_bound
from skd_sim import Trajectory, UsageError

STEP = 0.3


def path(points, name: str = "", time_step: float = STEP) -> Trajectory:
    return Trajectory(np.asarray(points, dtype=float), time_step, name)


def crossing(n: int, offset: float = 0.0, name: str = "") -> Trajectory:
    return path([(0.75 * i, offset) for i in range(n)], name)


def test_parallel_paths_by_hand():
    found = compute_skd([(crossing(9), [crossing(9, 1.0), crossing(9, 2.0), crossing(9, 3.0)])])
    skd = found.distances
    assert (skd.mean, skd.variance, skd.values.size) == (2.0, 1.0, 3)
    assert skd.plain_interval == pytest.approx((2 - 1.959964 / math.sqrt(3), 2 + 1.959964 / math.sqrt(3)), abs=1e-6)
    assert skd.interval is None  # one φ says nothing about how φ differ
    assert (found.prefixes.mean, found.discarded) == (2.0, 0)
    assert skd.means == found.prefixes.means == [2.0]


def test_the_end_of_phi_is_a_floor_under_the_distance_and_not_under_the_prefix_distance():
    phi = crossing(11)
    hit_early = crossing(5, 0.5)  # ends after 4 steps, 3 m along; φ goes on to 7.5 m
    found = compute_skd([(phi, [hit_early])])
    assert found.distances.mean == pytest.approx(math.hypot(4.5, 0.5))
    assert found.prefixes.mean == 0.5
    assert phi.prefix(len(hit_early)).duration == hit_early.duration


def test_maximum_distance_leaves_out_and_counts():
    phi = crossing(9)
    psis = [crossing(9, 1.0), crossing(9, 5.0), crossing(9, 2.0), crossing(9, 2.5)]
    found = compute_skd([(phi, psis), (phi, [crossing(9, 9.0)])], maximum_distance=2.0)
    assert found.distances.mean == 1.5  # a pair exactly at the maximum stays
    assert [rows.tolist() for rows in found.kept] == [[0, 2], []]
    assert (found.discarded, found.distances.means) == (3, [1.5, None])


def test_other_time_step_is_refused_by_name():
    psi = path([(0.0, 0.0), (1.0, 0.0)], "clip 7", time_step=0.1)
    with pytest.raises(UsageError, match=r"clip 7.*time step of 0.1 s.*0.3 s"):
        compute_skd([(crossing(5, name="walk 3"), [crossing(5), psi])])


@pytest.mark.parametrize("maximum", [-1.0, math.nan])
def test_impossible_maximum_distance_is_refused(maximum):
    with pytest.raises(UsageError, match="maximum distance"):
        compute_skd([(crossing(5), [])], maximum_distance=maximum)


def test_the_interval_of_the_bound_is_that_of_the_jackknife_over_safe_trajectories():
    """Leaving out one φ at a time and the delta method agree to first order, where φ have many pairs."""
    rng = np.random.default_rng(8)
    groups = [2.0 + 0.03 * rng.normal() + 0.4 * rng.normal(size=300) for _ in range(40)]

    def bound(left):
        values = np.concatenate(left)
        return frechet_probability_bound(0.5, values.mean(), values.var(ddof=1))

    without = np.array([bound(groups[:one] + groups[one + 1 :]) for one in range(len(groups))])
    error = math.sqrt((len(groups) - 1) * without.var())
    low, high = bound_interval(groups, 0.5, 0.9)
    freedom = len(groups) - 1
    assert bound(groups) - low > high - bound(groups)  # distances are skewed to the right, the bound to the left
    assert high - bound(groups) == pytest.approx(stats.t.ppf(0.95, freedom) * error, rel=0.03)
    assert bound_interval(groups[:1], 0.5) is None
