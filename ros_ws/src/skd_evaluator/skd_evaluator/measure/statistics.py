"""Intervals and bounds that are reported beside a rate or a mean."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy import special  # scipy.stats would be half a second at every start

Interval = tuple[float, float]
FloatArray = npt.NDArray[np.float64]


def mean(values: npt.ArrayLike) -> float:
    """Return the mean, correctly summed: the same bits in whatever order the values come.

    Raises:
        ValueError: there is no value, or they are not a plain list of finite numbers.
    """
    numbers = _numbers(values)
    if numbers.size == 0:
        raise ValueError("the mean of no values is not defined")
    return math.fsum(numbers) / numbers.size


def sample_variance(values: npt.ArrayLike) -> float | None:
    """Return the unbiased variance (n − 1 below the line); None for fewer than two values.

    Raises:
        ValueError: the values are not a plain list of finite numbers.
    """
    numbers = _numbers(values)
    if numbers.size < 2:
        return None
    centre = math.fsum(numbers) / numbers.size
    return math.fsum((numbers - centre) ** 2) / (numbers.size - 1)


def wilson_interval(successes: int, trials: int, confidence: float = 0.95) -> Interval | None:
    """Return Wilson's score interval for a proportion (Wilson 1927), without continuity correction.

    Args:
        successes: 0 … trials.
        trials: ≥ 0.
        confidence: two-sided, in (0, 1).

    Returns:
        (low, high) within [0, 1]; None without a trial, as nothing is known then.

    Raises:
        ValueError: the counts contradict each other, or the confidence is outside (0, 1).
    """
    z = _two_sided_quantile(confidence)
    if not 0 <= successes <= trials:
        raise ValueError(f"successes must be from 0 to the number of trials, got {successes} of {trials}")
    if trials == 0:
        return None
    rate = successes / trials
    shrink = 1.0 + z * z / trials
    centre = (rate + z * z / (2 * trials)) / shrink
    half = z * math.sqrt(rate * (1.0 - rate) / trials + z * z / (4 * trials * trials)) / shrink
    # Algebra says exactly 0 and 1 at the ends; rounding would say 1e-17.
    low = 0.0 if successes == 0 else max(0.0, centre - half)
    high = 1.0 if successes == trials else min(1.0, centre + half)
    return low, high


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
    numbers = _numbers(values)
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
        ValueError: the lists differ in length or hold what is no finite number, the denominators' mean is not
            positive, or the confidence is outside (0, 1).
    """
    z = _two_sided_quantile(confidence)
    above, below = _numbers(numerators), _numbers(denominators)
    if above.size != below.size:
        raise ValueError(f"there are {above.size} numerators and {below.size} denominators")
    if above.size < 2:
        return None
    centre = mean(below)
    if not centre > 0.0:
        raise ValueError(f"the mean of the denominators must be positive, got {centre}")
    ratio = mean(above) / centre
    variance = sample_variance(above - ratio * below)
    assert variance is not None
    half = z * math.sqrt(variance / above.size) / centre
    return ratio - half, ratio + half


def cluster_bootstrap_interval(
    groups: Sequence[npt.ArrayLike],
    seed: int | np.random.SeedSequence,
    resamples: int = 2000,
    confidence: float = 0.95,
) -> Interval | None:
    """Return a percentile bootstrap interval for the mean over all pairs, pairs of one group kept together.

    Pairs that share a φ are not independent, so whole groups are drawn with replacement, as many as there
    are, and the mean is taken over all pairs of the drawn groups (Davison and Hinkley, Bootstrap Methods
    and their Application, 1997, section 3.8). Groups without a pair have no say in the mean and are left
    out. With few groups (below about ten) such an interval tends to be too narrow.

    Args:
        groups: the values of each group.
        seed: of the draws; the same seed gives the same interval.
        resamples: number of draws, ≥ 1.
        confidence: two-sided, in (0, 1).

    Returns:
        (low, high) in the unit of the values; None for fewer than two groups with pairs, as nothing is then
        known about how groups differ.

    Raises:
        ValueError: values that are not finite numbers, no resample, or a confidence outside (0, 1).
    """
    _two_sided_quantile(confidence)
    if resamples < 1:
        raise ValueError(f"resamples must be at least 1, got {resamples}")
    filled = [numbers for numbers in map(_numbers, groups) if numbers.size > 0]
    if len(filled) < 2:
        return None
    sums = np.array([math.fsum(numbers) for numbers in filled])
    counts = np.array([numbers.size for numbers in filled])
    sequence = seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
    drawn = np.random.default_rng(sequence).integers(len(filled), size=(resamples, len(filled)))
    means = sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    tail = (1.0 - confidence) / 2.0
    low, high = np.quantile(means, [tail, 1.0 - tail])
    return float(low), float(high)


def frechet_probability_bound(eta: float, mean: float, variance: float) -> float:
    """Return the paper's Theorem 1: an upper bound of P(d ≤ η), at most 1.

    (Var + 2ηδ) / (Var + δ²), from the Paley–Zygmund inequality for a distance d ≥ 0 with mean δ.

    Args:
        eta: η, m, in (0, δ).
        mean: δ, the SKD, m, > 0.
        variance: of d, m², ≥ 0.

    Raises:
        ValueError: η outside (0, δ), or a mean or variance that no distance can have.
    """
    if not (math.isfinite(mean) and mean > 0.0):
        raise ValueError(f"the mean distance must be positive and finite, got {mean}")
    if not (math.isfinite(variance) and variance >= 0.0):
        raise ValueError(f"the variance must be finite and not negative, got {variance}")
    if not 0.0 < eta < mean:
        raise ValueError(f"η must be between 0 and the mean distance {mean}, both excluded, got {eta}")
    return min(1.0, (variance + 2.0 * eta * mean) / (variance + mean * mean))


def _two_sided_quantile(confidence: float) -> float:
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence must be between 0 and 1, both excluded, got {confidence}")
    return float(special.ndtri(0.5 + confidence / 2.0))


def _numbers(values: npt.ArrayLike) -> FloatArray:
    numbers: FloatArray = np.asarray(values, dtype=np.float64)
    if numbers.ndim != 1:
        raise ValueError(f"values must be a plain list of numbers, got shape {numbers.shape}")
    if not np.isfinite(numbers).all():
        raise ValueError("values must be finite")
    return numbers
