"""Intervals and bounds that are reported beside a rate or a mean."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import scipy
from skd_sim.world.state import FloatArray

Interval = tuple[float, float]


def mean(values: npt.ArrayLike) -> float:
    """Return the mean, correctly summed: the same bits in whatever order the values come.

    Raises:
        ValueError: there is no value, or they are not a plain list of finite numbers.
    """
    numbers = plain_numbers(values)
    if numbers.size == 0:
        raise ValueError("the mean of no values is not defined")
    return math.fsum(numbers) / numbers.size


def sample_variance(values: npt.ArrayLike) -> float | None:
    """Return the unbiased variance (n − 1 below the line); None for fewer than two values.

    Raises:
        ValueError: the values are not a plain list of finite numbers.
    """
    numbers = plain_numbers(values)
    if numbers.size < 2:
        return None
    centre = math.fsum(numbers) / numbers.size
    return math.fsum((numbers - centre) ** 2) / (numbers.size - 1)


def wilson_interval(successes: int, trials: int, confidence: float = 0.95) -> Interval | None:
    """Return Wilson's score interval for a proportion (Wilson 1927), without continuity correction.

    Args:
        successes: number of successes, 0 … trials.
        trials: number of trials, ≥ 0.
        confidence: two-sided, in (0, 1).

    Returns:
        (low, high) within [0, 1]; None without a trial, as nothing is known then.

    Raises:
        ValueError: the confidence is outside (0, 1).
    """
    z = _two_sided_quantile(confidence)
    if trials == 0:
        return None
    return score_interval(successes / trials, trials, z)


def score_interval(rate: float, trials: float, quantile: float) -> Interval:
    """Return the lowest and highest rate, in [0, 1], at most `quantile` standard errors from the observed one.

    Args:
        rate: the observed rate, in [0, 1].
        trials: how many independent ones say as much, > 0; need not be whole.
        quantile: how many standard errors, > 0.
    """
    square = quantile * quantile
    shrink = 1.0 + square / trials
    centre = (rate + square / (2 * trials)) / shrink
    half = quantile * math.sqrt(rate * (1.0 - rate) / trials + square / (4 * trials * trials)) / shrink
    # Algebra says exactly 0 and 1 at the ends; rounding would say 1e-17.
    low = 0.0 if rate == 0.0 else max(0.0, centre - half)
    high = 1.0 if rate == 1.0 else min(1.0, centre + half)
    return low, high


def jeffreys_interval(successes: int, trials: int) -> Interval | None:
    """Return Jeffreys's 95 % interval for a proportion (Brown, Cai and DasGupta, Statistical Science 16, 2001).

    Of rare events it holds 95 %, where Wilson's interval misses one seen by chance. Counts and what is returned are
    those of `wilson_interval`.
    """
    tail, posterior = 0.5 * (1.0 - 0.95), (successes + 0.5, trials - successes + 0.5)  # digests have this last bit
    low = float(scipy.special.betaincinv(*posterior, tail)) if successes else 0.0
    high = float(scipy.special.betaincinv(*posterior, 1.0 - tail)) if successes < trials else 1.0
    return (low, high) if trials else None


def normal_interval(values: npt.ArrayLike, confidence: float = 0.95) -> Interval | None:
    """Return mean ± z·s/√n, s the sample standard deviation: the interval of the paper's tables.

    Args:
        values: n numbers, taken as independent.
        confidence: two-sided, in (0, 1).

    Returns:
        (low, high) in the unit of the values; None for fewer than two values.

    Raises:
        ValueError: the values are not a plain list of finite numbers, or the confidence is outside (0, 1).
    """
    z = _two_sided_quantile(confidence)
    numbers = plain_numbers(values)
    variance = sample_variance(numbers)
    if variance is None:
        return None
    centre = mean(numbers)
    half = z * math.sqrt(variance / numbers.size)
    return centre - half, centre + half


def ratio_interval(numerators: npt.ArrayLike, denominators: npt.ArrayLike, confidence: float = 0.95) -> Interval | None:
    """Return an interval for the ratio of two means over the same n items, by the delta method.

    r ± z·s/(√n·ȳ), with r = x̄/ȳ and s the sample standard deviation of x − r·y: what x and y have in common, being of
    the same item, drops out (Cochran, Sampling Techniques, 3rd ed. 1977, on ratio estimators).

    Args:
        numerators: x, n numbers.
        denominators: y, of the same items; their mean must be positive.
        confidence: two-sided, in (0, 1).

    Returns:
        (low, high); None for fewer than two items.

    Raises:
        ValueError: the lists hold what is no finite number, or the confidence is outside (0, 1).
    """
    z = _two_sided_quantile(confidence)
    above, below = plain_numbers(numerators), plain_numbers(denominators)
    if above.size < 2:
        return None
    centre = mean(below)
    ratio = mean(above) / centre
    variance = sample_variance(above - ratio * below)
    assert variance is not None
    half = z * math.sqrt(variance / above.size) / centre
    return ratio - half, ratio + half


def frechet_probability_bound(eta: float, mean: float, variance: float) -> float:
    """Return the paper's Theorem 1: an upper bound of P(d ≤ η), at most 1.

    (Var + 2ηδ) / (Var + δ²), from the Paley–Zygmund inequality for a distance d ≥ 0 with mean δ.

    Args:
        eta: η, m, in (0, δ).
        mean: δ, the SKD, m, > 0.
        variance: variance of d, m², ≥ 0.
    """
    return min(1.0, (variance + 2.0 * eta * mean) / (variance + mean * mean))


def cantelli_bound(eta: float, mean: float, variance: float) -> float:
    """Return Cantelli's upper bound of P(d ≤ η): Var / (Var + (δ − η)²).

    It asks nothing of d but its mean and variance, is never above Theorem 1's bound, and cannot be bettered from these
    two alone where d may be negative: a law of two points, η and δ + Var/(δ − η), attains it (Cantelli 1928).

    Args:
        eta: η, m, in [0, δ).
        mean: δ, the mean distance, m, > 0.
        variance: variance of d, m², ≥ 0.
    """
    return variance / (variance + (mean - eta) ** 2)


def bound_influence(distances: npt.ArrayLike, eta: float, mean: float, variance: float) -> FloatArray:
    """Return how much each distance has to do with Theorem 1's bound: its derivative by the weight of that distance.

    The bound is 1 − (δ² − 2ηδ)/μ₂ with μ₂ = Var + δ² the mean square; the influence of a distance d is the bound's
    gradient by δ and μ₂ times (d − δ, d² − μ₂).

    Args:
        distances: the distances in the sample, m.
        eta: η, m, in (0, δ).
        mean: δ of the sample, m, > 0.
        variance: variance of the sample, m², ≥ 0.
    """
    values = plain_numbers(distances)
    square = variance + mean * mean
    by_mean = -2.0 * (mean - eta) / square
    by_square = (mean * mean - 2.0 * eta * mean) / (square * square)
    return by_mean * (values - mean) + by_square * (values**2 - square)


def checked_confidence(confidence: float) -> float:
    """Return the confidence of an interval.

    Raises:
        ValueError: it is not between 0 and 1.
    """
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence must be between 0 and 1, both excluded, got {confidence}")
    return confidence


def _two_sided_quantile(confidence: float) -> float:
    return float(scipy.special.ndtri(0.5 + checked_confidence(confidence) / 2.0))


def plain_numbers(values: npt.ArrayLike) -> FloatArray:
    """Return values as an array.

    Raises:
        ValueError: they are not a plain list of finite numbers.
    """
    numbers: FloatArray = np.asarray(values, dtype=np.float64)
    if numbers.ndim != 1:
        raise ValueError(f"values must be a plain list of numbers, got shape {numbers.shape}")
    if not np.isfinite(numbers).all():
        raise ValueError("values must be finite")
    return numbers
