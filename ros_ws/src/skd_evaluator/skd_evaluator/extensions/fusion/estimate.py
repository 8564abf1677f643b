"""The mean of a physical figure over all φ, from few trials and from what a simulator says of these φ and of many more.

With y the figure of a φ in physical trials, x the one that the simulator predicts for it, n such pairs and N simulated
φ,

    fused = ȳ + b (x̄ of all N − x̄ of the n),        b the slope of the line of least squares through the pairs.

That is the regression estimator of double sampling (W. G. Cochran, Sampling Techniques, 3rd ed. 1977, chapter 12; as a
control variate: R. B. Nelson, Operations Research 38, 1990) and prediction-powered inference with its tuning weight
chosen by the data (Angelopoulos et al., Science 382, 2023; Angelopoulos, Duchi and Zrnic, arXiv 2311.01453; for robots
and simulators Luo et al., arXiv 2506.20553). Its squared error is

    s² (1/n + (x̄ of all − x̄ of the n)²/Sxx) + b² sx²/N,

with s² the residual variance with n − 2 degrees of freedom; its interval has Student's quantile of as many. With normal
pairs and large N it is exact, however wrong the simulator: a bias of the simulator drops out, for x̄ − x̄ has none.

Student's interval leaves skewed figures too often on the side of the long tail; there it reaches further by the term of
order 1/√n in the distribution of the studentised mean (N. J. Johnson, Journal of the American Statistical Association
73, 1978; P. Hall, Annals of Statistics 16, 1988), and on the other side it stays; or as far as the shape of the
simulated figures asks for (`rehearsed`), if that is further. Physical trials alone get the same.

How far an interval reaches: Student's quantile is right for normal figures. A clearance ends at 0 and has a long tail;
a required deceleration is 0 on most φ and large on a few. Ten trials do not show such a shape, but thousands of
simulated φ do. So the trials are rehearsed: n φ drawn at random from the simulated ones, each time with
the estimate and its standard error. Where the quantiles of (estimate − truth)/error lie further out than those of the
same draws of normal figures, the interval reaches as many times further: a bootstrap-t (B. Efron and R. J. Tibshirani,
An Introduction to the Bootstrap, 1993, section 12.5) that draws from the simulator's φ and not from the few trials.

What is assumed is a shape and no size: the physical figure, and what the simulator does not know of it, is over φ about
as skewed as the simulated figure, to the side to which the trials lean. Where φ with trials that are too much alike are
refused (`least_variance`), such draws are left out.

A rate's interval has to stay in [0, 1] and to hold near its ends, so the squared error of the regression estimator is
turned into an effective number of trials, as in `metrics.clustered.clustered_rate`. Pairs that a simulator predicts
well leave no residuals although it will be wrong some day: as Agresti and Coull (The American Statistician 52, 1998) do
for a plain rate, two trials in which it was wrong are added to the residual variance.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import special
from skd_sim.world.state import FloatArray

from skd_evaluator.metrics.clustered import cluster_error, components_of, student_quantile
from skd_evaluator.metrics.entry import Entry
from skd_evaluator.metrics.sample_size import mean_of_root
from skd_evaluator.metrics.statistics import Interval, checked_confidence, score_interval

_DRAWS, _NUMBERS = 2000, 2_000_000
_LEAST = 200
"""Draws that have to be left to tell a quantile."""
_SEED = 28
_NOTHING = 1e-12


Reach = tuple[float, float]
"""How many times as far as Student's an interval reaches below and above the estimate, at least 1."""


def rehearsed(
    population: FloatArray, count: int, confidence: float, *, by_line: bool, mirrored: bool, least: float
) -> Reach:
    """Return how far an interval reaches by rehearsals.

    Args:
        population: simulated figures of all φ.
        count: φ with trials, ≥ 5.
        confidence: two-sided.
        by_line: whether the estimate is that of the line through pairs; else the mean of the trials by themselves.
        mirrored: whether what is estimated leans to the other side than the simulated figures do.
        least: variance of the simulated figures of a draw, as a share of that of all, below which nothing is said.

    Returns:
        Student's, where the simulated figures do not vary, and so have no shape; infinite where draws too often say
        nothing.
    """
    checked_confidence(confidence)
    shape = np.sort(population - math.fsum(population) / population.size)
    deviation = float(np.sqrt(np.mean(shape**2)))
    if not deviation > 1e-9 * float(np.abs(population).max()):
        return 1.0, 1.0
    low, high = _quantiles(shape / deviation, count, confidence, by_line=by_line, least=least)
    normal_low, normal_high = _of_normal(shape.size, count, confidence, by_line=by_line, least=least)
    below, above = max(1.0, high / normal_high), max(1.0, low / normal_low)
    return (above, below) if mirrored else (below, above)


def kurtosis(population: FloatArray) -> float:
    """Return the kurtosis of simulated figures, 3 for normal ones; 0 where they do not vary."""
    off = population - population.mean()
    square = float(np.mean(off**2))
    return float(np.mean(off**4)) / square**2 if square > 0.0 else 0.0


@lru_cache(maxsize=64)
def _of_normal(size: int, count: int, confidence: float, *, by_line: bool, least: float) -> tuple[float, float]:
    """Return the quantiles of the same draws, were the figures normal."""
    shape = special.ndtri((np.arange(size) + 0.5) / size)
    return _quantiles(shape / np.sqrt(np.mean(shape**2)), count, confidence, by_line=by_line, least=least)


def _quantiles(shape: FloatArray, count: int, confidence: float, *, by_line: bool, least: float) -> tuple[float, float]:
    """Return the quantiles of (estimate − truth)/error over draws from figures of mean 0 and deviation 1."""
    rng = np.random.default_rng(np.random.SeedSequence(_SEED, spawn_key=(count,)))
    draws = max(_LEAST, min(_DRAWS, _NUMBERS // count))
    unknown = shape[rng.integers(shape.size, size=(draws, count))]
    known = shape[rng.integers(shape.size, size=(draws, count))] if by_line else unknown
    if by_line:
        estimate, squared = _by_line(unknown, known)
    else:
        estimate, squared = unknown.mean(axis=1), unknown.var(axis=1, ddof=1) / count
    vary = known.var(axis=1, ddof=1) >= max(_NOTHING, least)
    if int(vary.sum()) < _LEAST // 2:
        return -math.inf, math.inf
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.where(squared > _NOTHING, estimate / np.sqrt(squared), np.copysign(math.inf, estimate))[vary]
    tail = 0.5 - confidence / 2.0
    low, high = np.quantile(off, [tail, 1.0 - tail], method="higher")
    return float(low), float(high)


def _by_line(unknown: FloatArray, known: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the regression estimator of each row, of which the truth is 0, and its squared error."""
    count = unknown.shape[1]
    centre, mean = known.mean(axis=1), unknown.mean(axis=1)
    aside, off = known - centre[:, None], unknown - mean[:, None]
    spread = np.maximum((aside**2).sum(axis=1), _NOTHING)
    slope = (aside * off).sum(axis=1) / spread
    left = ((off - slope[:, None] * aside) ** 2).sum(axis=1) / (count - 2.0)
    return mean - slope * centre, left * (1.0 / count + centre**2 / spread)


LEAST_PAIRS = 5
"""φ with physical trials below which nothing is said: Student's quantile of two degrees of freedom is 4.3."""
PREDICTS = 0.1
"""p-value of no positive slope (one-sided) below which the simulator predicts, and the fused interval stands."""
SELDOM = 0.05
"""Share of random samples of φ that are as much alike as those of which nothing is said."""
_MOST_TRIALS = 10**7


@dataclass(frozen=True)
class Mean(Entry):
    """A mean with its interval and standard error."""

    KEYS = "value interval error"

    value: float
    interval: Interval
    error: float

    @property
    def width(self) -> float:
        """From the lower to the upper end."""
        return self.interval[1] - self.interval[0]


@dataclass(frozen=True)
class Line:
    """The line of least squares through pairs, and whether its slope is more than chance.

    Attributes:
        slope: of the physical figure by the simulated one; None where all simulated ones are the same.
        correlation: of the pairs; None where one side does not vary.
        p_value: one-sided, of a slope that is not positive.
        residual: residual variance, with n − 2 degrees of freedom.
        spread: Sxx, sum of squares of the simulated figures.
    """

    slope: float | None
    correlation: float | None
    p_value: float
    residual: float
    spread: float

    @property
    def residual_deviation(self) -> float:
        """Root of the residual variance."""
        return float(self.residual**0.5)

    @property
    def predicts(self) -> bool:
        """Whether the simulator predicts the physical figure: where φ are worse in one, they are in the other."""
        return self.p_value < PREDICTS


def fitted_line(y: FloatArray, x: FloatArray) -> Line:
    """Return the line through pairs of a physical and a simulated figure."""
    a, b = x - math.fsum(x) / x.size, y - math.fsum(y) / y.size
    spread, common, own = float(a @ a), float(a @ b), float(b @ b)
    if spread <= _rounding(x) or own <= _rounding(y):
        return Line(None if spread <= _rounding(x) else 0.0, None, 1.0, own / max(1, y.size - 2), spread)
    slope, freedom = common / spread, y.size - 2.0
    left = max(0.0, own - slope * common)
    correlation = max(-1.0, min(1.0, common / math.sqrt(spread * own)))
    if left <= _rounding(y):
        return Line(slope, correlation, float(correlation <= 0.0), left / freedom, spread)
    beyond = correlation * math.sqrt(freedom / (left / own))
    return Line(slope, correlation, float(special.stdtr(freedom, -beyond)), left / freedom, spread)


def alone(y: FloatArray, confidence: float = 0.95, reach: Reach = (1.0, 1.0)) -> Mean:
    """Return the mean of physical figures, one of each φ, by themselves: Student's interval, further out where skewed.

    Args:
        y: the figures.
        confidence: two-sided.
        reach: how many times as far as Student's the interval reaches.

    Raises:
        ValueError: they are all the same: nothing is known of how they vary.
    """
    centre = math.fsum(y) / y.size
    deviations = y - centre
    variance = float(deviations @ deviations) / (y.size - 1)
    if variance * y.size <= _rounding(y):
        raise ValueError(f"all {y.size} physical figures are {y[0]:.6g}: nothing is known of how they vary")
    error = math.sqrt(variance / y.size)
    return Mean(centre, _interval(centre, error, y.size - 1.0, deviations, confidence, reach), error)


def fused(
    y: FloatArray,
    x: FloatArray,
    population: FloatArray,
    line: Line,
    confidence: float = 0.95,
    *,
    wrong: float = 0.0,
    reach: Reach = (1.0, 1.0),
) -> Mean:
    """Return the mean over all φ from pairs and from every simulated figure.

    Args:
        y: physical figures, one of each φ.
        x: simulated figures of the same φ.
        population: simulated figures of all φ, those of the pairs among them.
        line: through the pairs; it has a slope.
        confidence: two-sided.
        wrong: trials in which the simulator was wrong that are added to the residuals (`TrialFigure`).
        reach: how many times as far as Student's the interval reaches.

    Raises:
        ValueError: the pairs lie on a line to the last digit, which no physical trial does.
    """
    slope = line.slope or 0.0
    if line.residual * y.size <= _rounding(y):
        raise ValueError("physical and simulated figures lie on one line to the last digit: are they the same data?")
    if not slope:
        return alone(y, confidence, reach)
    freedom = y.size - 2.0
    left = (line.residual * freedom + wrong * float(np.var(y, ddof=1))) / (freedom + wrong)
    value, error, residuals = _regressed(y, x, population, line, left)
    return Mean(value, _interval(value, error, freedom, residuals, confidence, reach), error)


def _regressed(
    y: FloatArray, x: FloatArray, population: FloatArray, line: Line, residual: float
) -> tuple[float, float, FloatArray]:
    """Return the regression estimator, its standard error by a residual variance, and the residuals of the pairs."""
    slope, centre = line.slope or 0.0, math.fsum(x) / x.size
    off = math.fsum(population) / population.size - centre
    residuals = y - math.fsum(y) / y.size - slope * (x - centre)
    squared = residual * (1.0 / y.size + off * off / line.spread)
    squared += slope * slope * float(np.var(population, ddof=1)) / population.size
    return math.fsum(y) / y.size + slope * off, math.sqrt(squared), residuals


def least_variance(count: int) -> float:
    """Return the share of the variance over all φ that random samples have, but for a share `SELDOM` of them."""
    freedom = count - 1.0
    return float(special.gammaincinv(0.5 * freedom, SELDOM)) * 2.0 / freedom


def trials_saved(pairs: int, narrower: float, confidence: float) -> int:
    """Return how many further φ of physical trials alone an interval as narrow would have taken.

    Args:
        pairs: φ with physical trials.
        narrower: width of the fused interval as a share of the one by the physical trials alone.
        confidence: of both.
    """

    def width(count: int) -> float:
        return student_quantile(count - 1.0, confidence) / math.sqrt(count)

    most = narrower * width(pairs)
    return bisect_left(range(pairs, _MOST_TRIALS), True, key=lambda count: width(count) <= most)


def _interval(
    value: float, error: float, freedom: float, residuals: FloatArray, confidence: float, reach: Reach
) -> Interval:
    """Return Student's interval, its end on the side of the residuals' long tail moved outwards."""
    quantile = student_quantile(freedom, checked_confidence(confidence))
    further = skewness(residuals) * (1.0 + 2.0 * quantile**2) / (6.0 * math.sqrt(residuals.size))
    below = max(quantile * reach[0], quantile - min(0.0, further))
    above = max(quantile * reach[1], quantile + max(0.0, further))
    return value - below * error, value + above * error


def skewness(residuals: FloatArray) -> float:
    """Return the sample skewness G1 of numbers of mean 0 (D. N. Joanes and C. A. Gill, The Statistician 47, 1998)."""
    count, square = residuals.size, float(np.mean(residuals**2))
    if square <= 0.0:
        return 0.0
    ratio = float(np.mean(residuals**3)) / float(square**1.5)
    return ratio * math.sqrt(count * (count - 1.0)) / (count - 2.0)


def _rounding(values: FloatArray) -> float:
    """Return a sum of squares that rounding alone may leave of numbers that are the same."""
    return float(values.size * (1e-9 * max(1e-300, float(np.abs(values).max()))) ** 2)


LEAST_OF_EACH = 3
"""φ with a hit, and φ with a trial without one, below which a line through hits says nothing: physical trials stand
alone."""
_ADDED = 2.0


def alone_rate(groups: Sequence[FloatArray], confidence: float = 0.95) -> Mean:
    """Return the rate of hits of physical trials by themselves, every φ counting as much as any other.

    It is the mean of the φ's own rates, as that with the simulator is; driving harmless φ again and again
    gives no safer car. Trials of one φ are at best independent of each other, so that they are no more than
    n²/Σ 1/mᵢ effective trials (m trials on each of n φ), however alike chance has made the φ. Where all φ have one rate
    nothing is known of how much less that is, and several trials of a φ are one.

    Args:
        groups: 1 for each trial of a φ with a hit, else 0; at least two φ.
        confidence: two-sided.
    """
    counts = np.array([one.size for one in groups], dtype=np.float64)
    rates, phi = np.array([one.sum() for one in groups]) / counts, len(groups)
    components = components_of(rates, counts, math.fsum(counts * rates * (1.0 - rates)))
    error, freedom = cluster_error(rates, counts, components, np.full(phi, 1.0 / phi))
    assert error is not None
    assert freedom is not None
    rate = math.fsum(rates) / phi
    effective = float(phi)
    if error > 0.0:
        effective = min(rate * (1.0 - rate) / error**2, phi**2 / math.fsum(1.0 / counts))
    return Mean(rate, score_interval(rate, effective, student_quantile(freedom, confidence)), error)


def fused_rate(y: FloatArray, x: FloatArray, population: FloatArray, line: Line, confidence: float = 0.95) -> Mean:
    """Return the rate of hits over all φ from pairs and from every simulated rate; arguments as of `fused`."""
    freedom = y.size - 2.0
    centre = float(np.clip(math.fsum(y) / y.size, 1e-6, 1.0 - 1e-6))
    residual = (line.residual * freedom + _ADDED * centre * (1.0 - centre)) / (freedom + _ADDED)
    value, error, _ = _regressed(y, x, population, line, residual)
    rate = float(np.clip(value, 1e-6, 1.0 - 1e-6))
    interval = score_interval(rate, rate * (1.0 - rate) / error**2, student_quantile(freedom, confidence))
    return Mean(min(1.0, max(0.0, value)), interval, error)


def fewest_of_each(groups: Sequence[FloatArray]) -> int:
    """Return how many φ there are with a hit, or with a trial without one, whichever are fewer."""
    return min(sum(bool(one.any()) for one in groups), sum(not one.all() for one in groups))


MOST = 10_000
"""φ with physical trials beyond which no number is named."""


def width_alone(trials: int, deviation: float) -> float:
    """Return how wide the interval of physical trials alone is expected to be, one trial on each φ.

    Args:
        trials: number of φ with a trial.
        deviation: standard deviation of the figure from φ to φ.
    """
    freedom = trials - 1.0
    return 2.0 * student_quantile(freedom) * mean_of_root(freedom) * deviation / math.sqrt(trials)


def width_fused(trials: int, deviation: float, correlation: float, simulated: int) -> float:
    """Return how wide the interval with the simulator is expected to be.

    The mean of (x̄ of all − x̄ of the n)²/Sxx over normal pairs is 1/(n (n − 3)).

    Args:
        trials: number of φ with a trial, ≥ 5.
        deviation: standard deviation of the physical figure from φ to φ.
        correlation: of physical and simulated figure.
        simulated: number of simulated φ.
    """
    freedom = trials - 2.0
    left = (1.0 - correlation**2) / trials * (1.0 + 1.0 / (trials - 3.0)) * mean_of_root(freedom) ** 2
    return 2.0 * student_quantile(freedom) * deviation * math.sqrt(left + correlation**2 / simulated)


def trials_for_width(
    width: float, deviation: float, correlation: float | None = None, simulated: int = 0
) -> int | None:
    """Return the least number of φ with a physical trial whose interval is expected to be so narrow.

    Args:
        width: that is requested, in the unit of the figure.
        deviation: of the figure from φ to φ.
        correlation: of physical and simulated figure; None: the physical trials stand alone.
        simulated: number of simulated φ.

    Returns:
        None where even `MOST` are not enough: fewer simulated φ than the width takes, or too little a width.
    """

    def enough(trials: int) -> bool:
        if correlation is None:
            return width_alone(trials, deviation) <= width
        return width_fused(trials, deviation, correlation, simulated) <= width

    counts = range(LEAST_PAIRS, (MOST if correlation is None else min(MOST, simulated)) + 1)
    found = bisect_left(counts, True, key=enough)
    return counts[found] if found < len(counts) else None
