"""Means and rates of values that come by φ, with intervals: pairs that share a φ are not independent of each other.

The safe trajectories are taken as a sample of those that there might be, and an interval speaks of the mean over all of
these. The mean is the one over all pairs. Its error comes from how the φ differ, by the bias-reduced estimate of Bell
and McCaffrey (Survey Methodology 28, 2002; "CR2"), and its quantile from Student's t with Satterthwaite's degrees of
freedom (Imbens and Kolesár, Review of Economics and Statistics 98, 2016). With equally many pairs for each φ that is
the t interval over the φ means.

*Rates*: the squared error of the rate, by φ, is that of an effective number of independent runs. Wilson's score
interval with that number and Student's quantile stays in [0, 1] and holds for rates near its ends (Dean and Pagano,
Journal of Survey Statistics and Methodology 3, 2015; Franco, Little, Louis and Slud, ibid. 7, 2019).

*Distances* have a prior (`Prior`), for five φ say little of how φ differ: they often are alike, and their mean is then
too small and looks more certain than it is. The values of φ number i are normal about a mean of their own with variance
σ², and these means normal about that of all φ with variance ρ·σ². Beforehand nothing is known of the mean of all φ and
of σ (p ∝ 1/σ²), and ln ρ has Student's t distribution about ln `ratio`, `spread` wide: so wide a tail gives way to what
φ show themselves (Gelman, Bayesian Analysis 1, 2006). The posterior of the mean is a mixture over ρ of Student's
distributions (Box and Tiao, Bayesian Inference in Statistical Analysis, 1973, section 5.2), and the interval holds the
middle of it. As a few φ ask for much more than the rest, the end on the side of the skewness is moved out by the term
of Cornish and Fisher's expansion (Johnson, Journal of the American Statistical Association 73, 1978).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
import numpy.typing as npt
import scipy
from skd_sim.world.state import FloatArray

from skd_evaluator.metrics.entry import Entry
from skd_evaluator.metrics.statistics import (
    Interval,
    checked_confidence,
    mean,
    normal_interval,
    plain_numbers,
    sample_variance,
    score_interval,
    wilson_interval,
)

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
class Clustered(Entry):
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

    KEYS = (
        "safe_trajectories=groups values standard_error degrees_of_freedom variance_between=components.between "
        "variance_within=components.within intraclass_correlation=components.correlation notes"
    )

    value: float
    interval: Interval | None
    standard_error: float | None
    degrees_of_freedom: float | None
    groups: int
    values: int
    components: VarianceComponents
    notes: tuple[str, ...] = ()


def student_quantile(degrees_of_freedom: float, confidence: float = 0.95) -> float:
    """Return how many standard errors a two-sided interval by Student's t reaches to each side."""
    return float(scipy.special.stdtrit(degrees_of_freedom, 0.5 + checked_confidence(confidence) / 2.0))


def variance_components(groups: Sequence[npt.ArrayLike]) -> VarianceComponents:
    """Return the variances between and within groups; groups without a value are left out.

    Raises:
        ValueError: the values are not plain lists of finite numbers.
    """
    return components_of(*_moments([numbers for numbers in map(plain_numbers, groups) if numbers.size]))


def _moments(filled: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray, float]:
    """Return mean and number of the values of each group, none of which is empty, and the sum of squares within all."""
    counts = np.array([one.size for one in filled], dtype=np.float64)
    means = np.array([mean(one) for one in filled])
    return means, counts, math.fsum(math.fsum((one - centre) ** 2) for one, centre in zip(filled, means, strict=True))


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
    means, counts, inside = _moments(filled)
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


def group_notes(filled: int, total: int) -> list[str]:
    """Return what a reader should know of an interval over so few groups, of which some may have no value."""
    found = []
    if filled < 2:
        found.append("one φ: no interval, for how φ differ is not known")
    elif filled < FEW:
        found.append(f"{filled} φ: an interval over so few is wide, and rests on the φ being of one kind")
    if filled < total:
        found.append(f"{total - filled} of {total} φ have nothing to count")
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


def clustered_rate(counts: Sequence[tuple[int, int]], confidence: float = 0.95) -> Clustered | None:
    """Return the share of hits among all trials with its interval over groups.

    Args:
        counts: hits and trials of each φ; a φ without trials does not count.
        confidence: two-sided, in (0, 1).

    Returns:
        None without a trial. One group has no interval.

    Raises:
        ValueError: counts that contradict each other, or a confidence outside (0, 1).
    """
    checked_confidence(confidence)
    for hits, runs in counts:
        if not 0 <= hits <= runs:
            raise ValueError(f"hits must be from 0 to the number of trials, got {hits} of {runs}")
    filled = np.array([one for one in counts if one[1] > 0], dtype=np.float64).reshape(-1, 2)
    if not len(filled):
        return None
    trials = filled[:, 1]
    rates = filled[:, 0] / trials
    total, every = int(filled[:, 0].sum()), int(trials.sum())
    rate = total / every
    components = components_of(rates, trials, math.fsum(trials * rates * (1.0 - rates)))
    error, freedom = cluster_error(rates, trials, components)
    notes = group_notes(len(filled), len(counts))
    interval = None
    if error is not None and freedom is not None:
        spread = rate * (1.0 - rate)
        effective = spread / error**2 if error > 0.0 else float(every)
        interval = score_interval(rate, effective, student_quantile(freedom, confidence))
        if total in (0, every):
            notes.append(
                f"{'none' if total == 0 else 'all'} of {every}: each counts as independent, and few φ widen it"
            )
        elif error == 0.0:
            notes.append("all φ have the same rate: each run counts as independent")
        elif effective > SUSPICIOUS * every:
            notes.append("the φ agree more than chance within them lets expect: the interval is narrow by luck")
    return Clustered(rate, interval, error, freedom, len(filled), every, components, tuple(notes))


@dataclass(frozen=True, eq=False)
class GroupedMean:
    """The mean of values that come by φ, with its intervals. What cannot be computed is None, never 0 or NaN.

    Attributes:
        groups: the values of each φ; a φ may have none.
        prior: what its interval over φ takes as known beforehand; None: Student's t.
        limits: numbers between which every value lies.
        confidence: confidence of the interval over φ; that over values has 95 %.
    """

    groups: tuple[FloatArray, ...]
    prior: Prior | None = None
    limits: Interval = (0.0, math.inf)
    confidence: float = 0.95

    @cached_property
    def values(self) -> FloatArray:
        """All values, φ by φ."""
        return np.concatenate([np.empty(0), *self.groups])

    @property
    def means(self) -> list[float | None]:
        """Mean of each φ; None without a value."""
        return [mean(one) if one.size else None for one in self.groups]

    @property
    def mean(self) -> float | None:
        """Mean over all values; None without any."""
        return mean(self.values) if self.values.size else None

    @property
    def variance(self) -> float | None:
        """Sample variance of the values; None below two."""
        return sample_variance(self.values)

    @property
    def plain_interval(self) -> Interval | None:
        """The paper's normal 95 % interval, values taken as independent; None below two values."""
        return normal_interval(self.values)

    @cached_property
    def clustered(self) -> Clustered | None:
        """The mean with what its error over φ is; None without a value."""
        return clustered_mean(self.groups, self.confidence, prior=self.prior, limits=self.limits)

    @property
    def interval(self) -> Interval | None:
        """Interval of the mean over φ; None where fewer than two φ have values."""
        return self.clustered.interval if self.clustered else None


@dataclass(frozen=True, eq=False)
class GroupedRate:
    """A share of trials that come by φ, with its intervals.

    Attributes:
        counts: for each φ how many of its trials count, and how many there are.
        confidence: confidence of the interval over φ; that over trials has 95 %.
    """

    counts: Sequence[tuple[int, int]]
    confidence: float = 0.95

    @property
    def hits(self) -> int:
        """Trials that count."""
        return sum(hits for hits, _ in self.counts)

    @property
    def trials(self) -> int:
        """All trials."""
        return sum(trials for _, trials in self.counts)

    @property
    def value(self) -> float | None:
        """The share; None without a trial."""
        return self.hits / self.trials if self.trials else None

    @property
    def plain_interval(self) -> Interval | None:
        """Wilson's 95 % interval, trials taken as independent; None without a trial."""
        return wilson_interval(self.hits, self.trials)

    @cached_property
    def clustered(self) -> Clustered | None:
        """The share with what its error over φ is; None without a trial."""
        return clustered_rate(self.counts, self.confidence)

    @property
    def interval(self) -> Interval | None:
        """Interval of it over φ; None where fewer than two φ have trials."""
        return self.clustered.interval if self.clustered else None


FREEDOM = 3.0
_PER_DECADE = 40
RATIOS = np.exp(np.linspace(math.log(1e-4), math.log(1e6), 10 * _PER_DECADE + 1))
"""ρ over which the posterior is added up."""
_CUT_OFF = 1e-3
"""Share of the posterior at the greatest ρ, in units of the largest, from which on there have to be greater ones."""
_BEYOND = 6
"""Decades that ρ reaches beyond what the φ show."""
_LEAST = 1e-280  # m²: below it squares become 0
_NEGLIGIBLE = 1e-10  # of the largest share of the posterior
EXACT = 0.0
"""Precision of an interval that is a figure: as near as rounding allows."""
_LEAST_RTOL = 4.0 * np.finfo(np.float64).eps  # that brentq takes


@dataclass(frozen=True)
class Prior:
    """What is known beforehand.

    Attributes:
        ratio: median of ρ, the variance between φ in units of that among the values of one φ.
        spread: scale of ln ρ.
        skewness: skewness of the means on φ; negative if a few of them are much less than the rest.
    """

    ratio: float
    spread: float
    skewness: float

    @property
    def mirrored(self) -> Prior:
        """The same for a figure that falls where a distance rises."""
        return replace(self, skewness=-self.skewness)

    def interval(
        self, means: FloatArray, counts: FloatArray, inside: float, confidence: float, precision: float = EXACT
    ) -> Interval | None:
        """Return how far the interval reaches below and above the mean over all values.

        Args:
            means: mean on each φ, at least two.
            counts: number of values on each φ.
            inside: sum of squares within all φ.
            confidence: two-sided, in (0, 1).
            precision: relative error that half the width may have.

        Returns:
            None where no φ has two values that differ: then there is nothing to measure the φ's differences by.
        """
        if not self.can_tell(inside):
            return None
        half = _half_width(self, tuple(means.tolist()), tuple(counts.tolist()), inside, confidence, precision)
        normal = float(scipy.special.ndtri(0.5 + confidence / 2.0))
        skewness = self.skewness + sample_skewness(means)
        if skewness * self.skewness <= 0.0:  # not to the other side
            skewness = 0.0
        moved = skewness * (1.0 + 2.0 * normal**2) / (6.0 * math.sqrt(len(means))) * half / normal
        return half - min(0.0, moved), half + max(0.0, moved)

    def can_tell(self, inside: float) -> bool:
        """Return whether there is an interval: the φ's differences are measured by the sum of squares within them."""
        return _LEAST < inside < math.inf

    def half_width(
        self, means: FloatArray, counts: FloatArray, inside: float, confidence: float, precision: float = EXACT
    ) -> float:
        """Return half the width of the interval before it is moved for skewness; arguments as of `interval`."""
        freedom = float(counts.sum()) - 1.0
        shares, spreads, squares = self._posterior(RATIOS, means, counts, inside)
        if shares[-1] > _CUT_OFF:  # the values of one φ hardly vary: what they show of ρ lies beyond
            shown = math.log10(means.var(ddof=1)) - math.log10(inside / freedom)
            decades = max(1, math.ceil(shown) + _BEYOND - 6)
            further = 1e6 * 10.0 ** (np.arange(1, decades * _PER_DECADE + 1) / _PER_DECADE)
            shares, spreads, squares = self._posterior(np.concatenate([RATIOS, further]), means, counts, inside)
        kept = shares > max(_NEGLIGIBLE, precision)
        weights = counts / counts.sum()
        errors = np.sqrt(squares / freedom * (spreads @ weights**2))[kept]
        level, parts = 0.5 + confidence / 2.0, shares[kept] / shares[kept].sum()
        low, high = scipy.special.stdtrit(freedom, level) * np.array([0.5 * errors.min(), 2.0 * errors.max()])

        def beyond(reach: float) -> float:
            return float(parts @ scipy.special.stdtr(freedom, reach / errors) - level)

        # brentq's own least tolerance, 2e-12 m, is the one of figures.
        return float(
            scipy.optimize.brentq(beyond, low, high, xtol=max(2e-12, precision * low), rtol=max(_LEAST_RTOL, precision))
        )

    def _posterior(
        self, ratios: FloatArray, means: FloatArray, counts: FloatArray, inside: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return for each ρ its share of the posterior, in units of the largest, and what its error follows from."""
        spreads = ratios[:, None] + 1.0 / counts  # variance of each mean, in units of σ²
        precisions = 1.0 / spreads
        together = precisions.sum(axis=1)
        centres = (precisions @ means) / together
        squares = inside + (precisions * (means - centres[:, None]) ** 2).sum(axis=1)
        freedom = float(counts.sum()) - 1.0
        steps = (np.log(ratios) - math.log(self.ratio)) / self.spread
        logarithms = -0.5 * (
            np.log(spreads).sum(axis=1)
            + np.log(together)
            + freedom * np.log(squares)
            + (FREEDOM + 1.0) * np.log1p(steps**2 / FREEDOM)
        )
        return np.exp(logarithms - logarithms.max()), spreads, squares


DISTANCES = Prior(ratio=0.02, spread=3.0, skewness=1.25)
"""Of deviation and Fréchet distance; docs/decisions.md (9) has where the numbers are from."""
MARGINS = Prior(ratio=0.02, spread=3.0, skewness=0.6)
"""Of margins, likewise: their φ means are less skewed."""
PREFIXES = Prior(ratio=0.04, spread=1.5, skewness=1.25)
"""Of distances to φ cut at the duration of ψ, likewise."""


@lru_cache(maxsize=4096)
def _half_width(
    prior: Prior,
    means: tuple[float, ...],
    counts: tuple[float, ...],
    inside: float,
    confidence: float,
    precision: float,
) -> float:
    """Return half the width before skewness; kept, for a result that is written is checked, shown and reported."""
    return prior.half_width(np.array(means), np.array(counts), inside, confidence, precision)


def sample_skewness(values: FloatArray) -> float:
    """Return the skewness of a sample, the third moment over the second's power of 3/2; 0 where all are the same."""
    deviations = values - values.mean()
    cube = float((deviations**2).mean()) ** 1.5
    return float((deviations**3).mean()) / cube if cube > 0.0 else 0.0
