"""Intervals of figures from few safe trajectories: pairs that share a φ are not independent of each other.

The safe trajectories are taken as a sample of those that there might be, and so what an interval speaks of is the mean
over all of these. The mean is the one over all pairs; its error comes from how the φ differ, by the bias-reduced
estimate of Bell and McCaffrey (Survey Methodology 28, 2002; "CR2"), and its quantile from Student's t with the degrees
of freedom that Satterthwaite's rule gives that estimate (Imbens and Kolesár, Review of Economics and Statistics 98,
2016). With equally many pairs for each φ that is the t interval over the φ means, with one degree of freedom less than
there are φ. Where it is known beforehand how φ means of a kind differ, as it is for distances, the interval is the one
that follows from that and the sample together (`prior`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy
from skd_sim.arrays import FloatArray

from skd_evaluator.metrics.statistics.prior import Prior
from skd_evaluator.metrics.statistics.statistics import Interval, checked_confidence, mean, plain_numbers

FEW = 5
"""Safe trajectories below which an interval over them is called one of few: Student's quantile then grows fast."""
SUSPICIOUS = 4.0
"""Ratio of the squared error expected without any difference between φ to the one found from which it is luck."""


@dataclass(frozen=True)
class VarianceComponents:
    """How much values differ between φ, and among the pairs of one φ: the balanced or unbalanced one-way layout.

    The analysis of variance's estimates (Searle, Casella and McCulloch, Variance Components, 1992, section 3.6), that
    between φ at least 0.

    Attributes:
        between: variance of the φ's own means, in the unit of the values squared; None below two φ.
        within: variance of the values of one φ; None where no φ has two.
    """

    between: float | None
    within: float | None

    @property
    def correlation(self) -> float | None:
        """Share of the variance that is between φ (intraclass correlation), in [0, 1]; None where it is not known."""
        if self.between is None or self.within is None or self.between + self.within <= 0.0:
            return None
        return self.between / (self.between + self.within)


@dataclass(frozen=True)
class Clustered:
    """The mean of values that come in groups, with what is known of its error.

    Attributes:
        value: mean over all values.
        interval: interval for the mean over all groups that there might be; None with fewer than two groups.
        standard_error: standard error of the mean; None with fewer than two groups.
        degrees_of_freedom: degrees of freedom of Student's t, by Satterthwaite's rule; None with fewer than two groups.
        groups: number of groups with values.
        values: number of values.
        components: variances between and within groups.
        notes: why the interval means less than it seems, a few words each.
    """

    value: float
    interval: Interval | None
    standard_error: float | None
    degrees_of_freedom: float | None
    groups: int
    values: int
    components: VarianceComponents
    notes: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return an entry under `clustering` of assessment.json."""
        return {
            "safe_trajectories": self.groups,
            "values": self.values,
            "standard_error": self.standard_error,
            "degrees_of_freedom": self.degrees_of_freedom,
            "variance_between": self.components.between,
            "variance_within": self.components.within,
            "intraclass_correlation": self.components.correlation,
            "notes": list(self.notes),
        }


def student_quantile(degrees_of_freedom: float, confidence: float) -> float:
    """Return how many standard errors a two-sided interval by Student's t reaches to each side."""
    return float(scipy.special.stdtrit(degrees_of_freedom, 0.5 + checked_confidence(confidence) / 2.0))


def variance_components(groups: Sequence[npt.ArrayLike]) -> VarianceComponents:
    """Return the variances between and within groups; groups without a value are left out.

    Raises:
        ValueError: the values are not plain lists of finite numbers.
    """
    filled = [numbers for numbers in map(plain_numbers, groups) if numbers.size]
    counts = np.array([numbers.size for numbers in filled], dtype=np.float64)
    means = np.array([mean(numbers) for numbers in filled])
    inside = math.fsum(math.fsum((numbers - centre) ** 2) for numbers, centre in zip(filled, means, strict=True))
    return components_of(means, counts, inside)


def components_of(means: FloatArray, counts: FloatArray, inside: float) -> VarianceComponents:
    """Return the components of groups of which means, numbers and the sum of squares within all are known."""
    groups, total = len(counts), float(counts.sum())
    within = inside / (total - groups) if total > groups else None
    if groups < 2:
        return VarianceComponents(None, within)
    centre = math.fsum(counts * means) / total
    squares = math.fsum(counts * (means - centre) ** 2) / (groups - 1)
    typical = (total - float((counts**2).sum()) / total) / (groups - 1)
    return VarianceComponents(max(0.0, (squares - (within or 0.0)) / typical), within)


def clustered_mean(
    groups: Sequence[npt.ArrayLike],
    confidence: float = 0.95,
    *,
    prior: Prior | None = None,
    limits: Interval = (-math.inf, math.inf),
) -> Clustered | None:
    """Return the mean over all values with its interval over groups.

    Args:
        groups: the values of each φ; a φ without values does not count, and is noted.
        confidence: two-sided, in (0, 1).
        prior: what is known of groups of this kind beforehand; nothing: Student's t.
        limits: numbers between which every value lies, and so the mean.

    Returns:
        None without a value. One group has no interval: nothing is known of how groups differ.

    Raises:
        ValueError: values that are not plain lists of finite numbers, or a confidence outside (0, 1).
    """
    checked_confidence(confidence)
    numbers = list(map(plain_numbers, groups))
    filled = [one for one in numbers if one.size]
    if not filled:
        return None
    counts = np.array([one.size for one in filled], dtype=np.float64)
    means = np.array([mean(one) for one in filled])
    inside = math.fsum(math.fsum((one - centre) ** 2) for one, centre in zip(filled, means, strict=True))
    components = components_of(means, counts, inside)
    value = mean(np.concatenate(filled))
    error, freedom = cluster_error(means, counts, components)
    interval = None
    if error is not None and freedom is not None:
        reach = prior and prior.interval(means, counts, inside, confidence)
        below, above = reach or (student_quantile(freedom, confidence) * error,) * 2
        interval = (max(limits[0], value - below), min(limits[1], value + above))
    notes = group_notes(len(filled), len(numbers))
    if interval is not None and interval[0] == interval[1]:
        notes.append("all φ have the same mean: the interval has no width, which says nothing about other φ")
    elif error is not None and components.within is not None and prior is None:
        expected = components.within * float((counts / counts.sum() ** 2).sum())
        if error**2 < expected / SUSPICIOUS:
            notes.append("the φ agree more than chance within them lets expect: the interval is narrow by luck")
    return Clustered(value, interval, error, freedom, len(filled), int(counts.sum()), components, tuple(notes))


def group_notes(filled: int, asked: int) -> list[str]:
    """Return what a reader should know of an interval over so few groups, of which some may have no value."""
    found = []
    if filled < 2:
        found.append("one φ: no interval, for how φ differ is not known")
    elif filled < FEW:
        found.append(f"{filled} φ: an interval over so few is wide, and rests on the φ being of one kind")
    if filled < asked:
        found.append(f"{asked - filled} of {asked} φ have nothing to count")
    return found


def cluster_error(
    means: FloatArray, counts: FloatArray, components: VarianceComponents, shares: FloatArray | None = None
) -> tuple[float | None, float | None]:
    """Return standard error and degrees of freedom of the mean over all values; None below two groups.

    The squared error is Σ wᵢ²·(x̄ᵢ − x̄)²/(1 − wᵢ), w being the groups' shares of the values: unbiased where values of
    a group are independent, and with groups of one size always. Satterthwaite's degrees of freedom are those of this
    quadratic form where a group's mean has the variance that the components give it.

    Args:
        means: mean of each group.
        counts: number of values in each group, ≥ 1.
        components: variances between and within groups, as `variance_components` returns them.
        shares: that each group has in the mean; None: that of its values. The error of a mean in which all have the
            same share is unbiased however much they differ in size.
    """
    if len(means) < 2:
        return None, None
    shares = counts / counts.sum() if shares is None else shares
    weights = shares**2 / (1.0 - shares)
    centred = np.eye(len(means)) - shares[None, :]
    deviations = means - math.fsum(shares * means)
    if np.ptp(means) == 0.0:  # not rounding
        deviations = np.zeros(len(means))
    spread = (components.between or 0.0) + (components.within or 0.0) / counts
    if not spread.sum() > 0.0:
        spread = 1.0 / counts
    form = (centred.T * weights) @ centred * (spread / spread.mean())
    freedom = float(np.trace(form) ** 2 / (form * form.T).sum())
    return math.sqrt(math.fsum(weights * deviations**2)), freedom
