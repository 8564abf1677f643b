from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats
from skd_evaluator.metrics.clustered import DISTANCES, clustered_mean
from skd_evaluator.metrics.frechet import discrete_frechet
from skd_evaluator.metrics.skd import bound_interval, compute_skd, kept_pairs
from skd_evaluator.metrics.statistics import frechet_probability_bound, normal_interval
from skd_sim.errors import UsageError
from skd_sim.world.state import Trajectory

STEP = 0.3


def path(points, name: str = "", time_step: float = STEP) -> Trajectory:
    return Trajectory(np.asarray(points, dtype=float), time_step, name)


def crossing(n: int, offset: float = 0.0, name: str = "") -> Trajectory:
    return path([(0.75 * i, offset) for i in range(n)], name)


def random_pairs(seed: int = 0, safe: int = 4, kamikazes: int = 15):
    rng = np.random.default_rng(seed)

    def walk(n: int) -> Trajectory:
        return path(np.cumsum(rng.normal(size=(n, 2)), axis=0))

    return [
        (
            Trajectory(walk(12).positions, STEP, f"φ{k}"),
            [walk(int(rng.integers(2, 18))) for _ in range(kamikazes + k)],
        )
        for k in range(safe)
    ]


def test_parallel_paths_by_hand():
    phi = crossing(9, name="straight")
    result = compute_skd([(phi, [crossing(9, 1.0), crossing(9, 2.0), crossing(9, 3.0)])])
    assert result.skd == 2.0
    assert result.variance == 1.0
    assert result.pairs == 3
    assert result.skd_ci95_pairs == pytest.approx((2 - 1.959964 / math.sqrt(3), 2 + 1.959964 / math.sqrt(3)), abs=1e-6)
    assert result.skd_ci95 is None  # one φ says nothing about how φ differ
    assert result.skd_prefix == 2.0
    assert result.discarded_by_distance == 0
    (row,) = result.per_safe_trajectory
    assert (row.name, row.pairs, row.mean_distance, row.mean_prefix_distance) == ("straight", 3, 2.0, 2.0)


def test_the_end_of_phi_is_a_floor_under_the_distance_and_not_under_the_prefix_distance():
    phi = crossing(11)
    hit_early = crossing(5, 0.5)  # ends after 4 steps, 3 m along; φ goes on to 7.5 m
    result = compute_skd([(phi, [hit_early])])
    assert result.skd == pytest.approx(math.hypot(4.5, 0.5))
    assert result.skd_prefix == 0.5
    cut = phi.prefix(len(hit_early))
    assert cut.duration == hit_early.duration


def test_kamikaze_longer_than_phi_meets_all_of_phi():
    phi, psi = crossing(4), crossing(9, 1.0)
    result = compute_skd([(phi, [psi])])
    assert result.skd == result.skd_prefix == discrete_frechet(phi.positions, psi.positions)


def test_equals_the_definitions_pair_by_pair():
    pairs = random_pairs()
    result = compute_skd(pairs)
    groups = [[discrete_frechet(phi.positions, psi.positions) for psi in psis] for phi, psis in pairs]
    every = [value for group in groups for value in group]
    prefixes = [discrete_frechet(phi.prefix(len(psi)).positions, psi.positions) for phi, psis in pairs for psi in psis]
    assert result.distances.tolist() == every
    assert result.prefix_distances.tolist() == prefixes
    assert result.skd == pytest.approx(np.mean(every), rel=1e-14)
    assert result.skd_prefix == pytest.approx(np.mean(prefixes), rel=1e-14)
    assert result.variance == pytest.approx(np.var(every, ddof=1), rel=1e-12)
    assert result.skd_ci95_pairs == normal_interval(every)
    assert result.skd_prefix_ci95_pairs == normal_interval(prefixes)
    assert result.clustered == clustered_mean(groups, prior=DISTANCES, limits=(0.0, math.inf))
    assert result.skd_ci95 == result.clustered.interval
    assert result.prefix_clustered.value == result.skd_prefix
    assert [row.name for row in result.per_safe_trajectory] == ["φ0", "φ1", "φ2", "φ3"]
    assert [row.pairs for row in result.per_safe_trajectory] == [15, 16, 17, 18]


def test_maximum_distance_leaves_out_and_counts():
    phi = crossing(9)
    psis = [crossing(9, 1.0), crossing(9, 5.0), crossing(9, 2.0), crossing(9, 2.5)]
    result = compute_skd([(phi, psis), (phi, [crossing(9, 9.0)])], maximum_distance=2.0)
    assert result.skd == 1.5  # a pair exactly at the maximum stays
    assert result.pairs == 2
    assert result.discarded_by_distance == 3
    near, far = result.per_safe_trajectory
    assert near.kept.tolist() == [0, 2]
    assert near.discarded_by_distance == 2
    assert (far.pairs, far.mean_distance, far.discarded_by_distance) == (0, None, 1)


def test_the_maximum_may_be_of_another_distance():
    """What is left out is decided by that one; the distances of the rest are as they are."""
    kept = kept_pairs("φ", np.array([1.0, 5.0]), np.array([0.5, 4.0]), np.array([2.5, 2.0]), 2.0)
    assert kept.kept.tolist() == [1]
    assert (kept.distances.tolist(), kept.prefix_distances.tolist()) == ([5.0], [4.0])
    assert kept.discarded_by_distance == 1


@pytest.mark.parametrize("pairs", [[], [(crossing(5), [])], [(crossing(5), []), (crossing(6), [])]])
def test_no_kamikaze_found_is_none_everywhere(pairs):
    result = compute_skd(pairs)
    assert result.skd is None
    assert result.skd_prefix is None
    assert result.skd_ci95_pairs is None
    assert result.skd_ci95 is None
    assert result.skd_prefix_ci95_pairs is None
    assert result.variance is None
    assert result.pairs == 0
    assert result.distances.shape == (0,)
    assert len(result.per_safe_trajectory) == len(pairs)
    with pytest.raises(ValueError, match="two pairs"):
        result.bound(0.1)


def test_bound_is_theorem_1_and_holds_for_its_own_sample():
    result = compute_skd(random_pairs(2))
    for share in (0.05, 0.2, 0.5, 0.8, 0.99):
        eta = share * result.skd
        assert result.bound(eta) == frechet_probability_bound(eta, result.skd, result.variance)
        assert np.mean(result.distances <= eta) <= result.bound(eta)
    with pytest.raises(ValueError, match="η"):
        result.bound(result.skd)


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


@pytest.mark.parametrize(("flat", "solid"), [(2, 3), (3, 2)])
def test_either_dimension_may_be_the_greater(flat, solid):
    with pytest.raises(UsageError, match=f"{solid} coordinates a position, φ has {flat}"):
        compute_skd([(path(np.zeros((4, flat))), [path(np.zeros((4, solid)))])])
