from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from skd_evaluator.metrics.statistics import (
    frechet_probability_bound,
    mean,
    normal_interval,
    ratio_interval,
    sample_variance,
    wilson_interval,
)

NUMBERS = st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=50)


@given(st.integers(1, 500).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))), st.floats(0.5, 0.999))
def test_wilson_equals_scipy(counts, confidence):
    successes, trials = counts
    theirs = stats.binomtest(successes, trials).proportion_ci(confidence, method="wilson")
    assert wilson_interval(successes, trials, confidence) == pytest.approx(tuple(theirs), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("trials", [1, 3, 7, 100, 12345])
def test_wilson_at_the_ends_is_exact_there_and_as_scipy_elsewhere(trials):
    none = wilson_interval(0, trials)
    every = wilson_interval(trials, trials)
    assert none[0] == 0.0
    assert every[1] == 1.0
    assert none[1] == pytest.approx(stats.binomtest(0, trials).proportion_ci(method="wilson").high)
    assert every[0] == pytest.approx(1.0 - none[1])


@given(NUMBERS, st.floats(0.5, 0.999))
def test_normal_interval_equals_scipy(values, confidence):
    spread = stats.sem(values)
    if spread > 1e-9:
        theirs = stats.norm.interval(confidence, loc=np.mean(values), scale=spread)
        assert normal_interval(values, confidence) == pytest.approx(theirs, rel=1e-7, abs=1e-6)


@given(NUMBERS, st.randoms())
def test_mean_and_variance_do_not_depend_on_order(values, shuffler):
    mixed = values.copy()
    shuffler.shuffle(mixed)
    assert mean(values) == mean(mixed)
    assert sample_variance(values) == sample_variance(mixed)
    assert mean(values) == pytest.approx(np.mean(values), rel=1e-9, abs=1e-9)
    assert sample_variance(values) == pytest.approx(np.var(values, ddof=1), rel=1e-7, abs=1e-9)


@given(st.floats(0.01, 100.0), st.floats(0.0, 1000.0), st.floats(0.001, 0.999))
def test_bound_follows_the_papers_algebra(delta, variance, share):
    eta = share * delta
    paley_zygmund = 1.0 - (1.0 - eta / delta) ** 2 * delta**2 / (variance + delta**2)
    papers_last_line = paley_zygmund + eta**2 / (variance + delta**2)
    bound = frechet_probability_bound(eta, delta, variance)
    assert 0.0 <= bound <= 1.0
    assert bound == pytest.approx(min(1.0, papers_last_line), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(
    "distribution", [stats.gamma(4.0), stats.expon(), stats.uniform(0.0, 2.0), stats.lognorm(0.5), stats.bernoulli(0.7)]
)
def test_bound_holds_for_distributions_of_nonnegative_distances(distribution):
    sample = distribution.rvs(size=200_000, random_state=np.random.default_rng(2))
    delta = float(distribution.mean())
    for share in (0.01, 0.1, 0.3, 0.6, 0.9):
        eta = share * delta
        assert np.mean(sample <= eta) <= frechet_probability_bound(eta, delta, float(distribution.var()))


@pytest.mark.parametrize(("eta", "centre", "variance"), [(0.0, 1.0, 1.0), (1.0, 1.0, 1.0), (0.5, 1.0, -1.0)])
def test_bound_outside_its_range_is_refused(eta, centre, variance):
    with pytest.raises(ValueError, match=r"must be"):
        frechet_probability_bound(eta, centre, variance)


def test_ratio_interval_covers_the_ratio_of_the_means():
    rng = np.random.default_rng(0)
    covered = 0
    for _ in range(400):
        below = rng.uniform(0.5, 1.5, 60)
        low, high = ratio_interval(3.0 * below + rng.normal(0.0, 0.3, 60), below)
        covered += low <= 3.0 <= high
    assert 0.91 <= covered / 400 <= 0.98  # 95 % of 400 trials, give or take three standard errors
