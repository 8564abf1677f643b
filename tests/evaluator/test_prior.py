"""The posterior of a mean over φ: by brute force over its own model, and how often it holds."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats
from skd_evaluator.metrics.clustered import FREEDOM, PREFIXES, Prior, clustered_mean, sample_skewness

PLAIN = Prior(ratio=0.1, spread=1.0, skewness=0.0)


@pytest.mark.parametrize("counts", [(6, 6, 6), (3, 9, 4, 7)])
def test_it_is_the_posterior_of_the_one_way_layout(counts):
    """Over a grid of σ and ρ, each weighed by how likely it makes the values; the mean of all φ given both.

    The density of all values is that of scipy's multivariate normal.
    """
    rng = np.random.default_rng(4)
    sample = [rng.normal(centre, 1.0, size=count) for centre, count in zip((1.0, 2.2, 1.4, 0.7), counts, strict=False)]
    values = np.concatenate(sample)
    owner = np.repeat(np.arange(len(counts)), counts)
    same = (owner[:, None] == owner[None, :]).astype(float)
    ones = np.ones(len(values))
    shares, centres, deviations = [], [], []
    for ratio in np.exp(np.linspace(math.log(1e-3), math.log(1e3), 56)):
        for sigma in np.exp(np.linspace(-1.2, 1.4, 24)):
            covariance = sigma**2 * (np.eye(len(values)) + ratio * same)
            inverse = np.linalg.inv(covariance)
            precision = ones @ inverse @ ones
            centre = ones @ inverse @ values / precision
            density = stats.multivariate_normal(centre * ones, covariance).logpdf(values)
            prior = stats.t.logpdf(math.log(ratio / PLAIN.ratio) / PLAIN.spread, FREEDOM)
            shares.append(density - 0.5 * math.log(precision) + prior)  # the grid is even in ln ρ and in ln σ
            weights = np.array(counts) / len(values)
            centres.append(centre)
            deviations.append(sigma * math.sqrt(((ratio + 1.0 / np.array(counts)) * weights**2).sum()))
    shares = np.exp(np.array(shares) - max(shares))
    shares /= shares.sum()
    found = clustered_mean(sample, prior=PLAIN)
    half = found.interval[1] - found.value
    assert found.value - found.interval[0] == pytest.approx(half)
    # About the mean over all values, which is the posterior's own centre where all groups are of one size.
    held = shares @ (2.0 * stats.norm.cdf(half / np.array(deviations)) - 1.0)
    assert held == pytest.approx(0.95, abs=3e-3)
    if len(set(counts)) == 1:
        assert centres == pytest.approx([found.value] * len(centres))


def test_the_skewness_moves_one_end_by_cornish_and_fishers_term():
    means, counts = np.array([1.0, 1.1, 1.2, 1.9]), np.full(4, 10.0)
    z = stats.norm.ppf(0.975)
    known = Prior(0.1, 1.0, 0.5)
    half = PLAIN.interval(means, counts, 30.0, 0.95)[0]
    together = 0.5 + stats.skew(means)
    moved = together * (1.0 + 2.0 * z * z) / (6.0 * math.sqrt(4)) * half / z
    assert known.interval(means, counts, 30.0, 0.95) == pytest.approx((half, half + moved))
    assert known.mirrored.interval(-means, counts, 30.0, 0.95) == pytest.approx((half + moved, half))
    assert known.interval(-means, counts, 30.0, 0.95) == pytest.approx((half, half))  # never to the other side
    assert sample_skewness(np.ones(5)) == 0.0
    assert PLAIN.interval(means, np.ones(4), 0.0, 0.95) is None


def test_it_holds_for_a_mixture_of_which_five_often_hold_one_kind_alone():
    """Three of four φ of one kind and every fourth of another, as synthetic φ are: Student's t misses from below."""
    rng = np.random.default_rng(8)
    trials, held, students = 400, 0, 0
    for _ in range(trials):
        means = np.where(rng.random((5, 1)) < 0.25, 0.25, 0.0) + rng.normal(0.0, 0.04, size=(5, 1))
        sample = list(means + rng.normal(0.0, 0.42, size=(5, 100)))
        for prior in (PREFIXES, None):
            low, high = clustered_mean(sample, prior=prior).interval
            inside = low <= 0.0625 <= high
            held, students = held + (inside and prior is not None), students + (inside and prior is None)
    error = math.sqrt(0.05 * 0.95 / trials)
    assert held / trials > 0.93 - 3.0 * error
    assert students / trials < held / trials - 3.0 * error
