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
simulated figures asks for (`rehearsal`), if that is further. Physical trials alone get the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy
from skd_sim.arrays import FloatArray

from skd_evaluator.extensions.fusion.estimate.rehearsal import Reach
from skd_evaluator.metrics.statistics.clustered import student_quantile
from skd_evaluator.metrics.statistics.statistics import Interval, checked_confidence, plain_numbers

LEAST_PAIRS = 5
"""φ with physical trials below which nothing is said: Student's quantile of two degrees of freedom is 4.3."""
PREDICTS = 0.1
"""p-value of no positive slope (one-sided) below which the simulator predicts, and the fused interval stands."""
SELDOM = 0.05
"""Share of draws by lot of φ that are as much alike as those of which nothing is said."""
_MOST_TRIALS = 10**7


@dataclass(frozen=True)
class Mean:
    """A mean with its interval and standard error."""

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
    def predicts(self) -> bool:
        """Whether the simulator predicts the physical figure: where φ are worse in one, they are in the other."""
        return self.p_value < PREDICTS


def checked_pairs(physical: FloatArray, simulated: FloatArray, every: FloatArray) -> tuple[FloatArray, ...]:
    """Return the three as arrays.

    Raises:
        ValueError: what is no finite number, pairs that do not match, too few of them, or fewer simulated φ than pairs.
    """
    y, x, population = map(plain_numbers, (physical, simulated, every))
    if y.size != x.size:
        raise ValueError(f"{y.size} physical and {x.size} simulated figures do not pair")
    if y.size < LEAST_PAIRS:
        raise ValueError(f"{y.size} pairs are too few: at least {LEAST_PAIRS} φ need physical trials")
    if population.size < y.size:
        raise ValueError(f"{population.size} simulated φ are fewer than the {y.size} of the pairs, which are of them")
    return y, x, population


def fitted_line(y: FloatArray, x: FloatArray) -> Line:
    """Return the line through pairs of a physical and a simulated figure."""
    spread, common, own = (float(one @ other) for one, other in _centred(y, x))
    if spread <= _rounding(x) or own <= _rounding(y):
        return Line(None if spread <= _rounding(x) else 0.0, None, 1.0, own / max(1, y.size - 2), spread)
    slope, freedom = common / spread, y.size - 2.0
    left = max(0.0, own - slope * common)
    correlation = max(-1.0, min(1.0, common / math.sqrt(spread * own)))
    beyond = math.inf if left <= _rounding(y) else correlation * math.sqrt(freedom / (left / own))
    chance = (
        float(scipy.special.stdtr(freedom, -beyond)) if math.isfinite(beyond) else 0.0 if correlation > 0.0 else 1.0
    )
    return Line(slope, correlation, chance, left / freedom, spread)


def alone(y: FloatArray, confidence: float = 0.95, reach: Reach | None = None) -> Mean:
    """Return the mean of physical figures, one of each φ, by themselves: Student's interval, further out where skewed.

    Args:
        y: the figures.
        confidence: two-sided.
        reach: how many times as far as Student's the interval reaches; None: not further.

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
    reach: Reach | None = None,
) -> Mean:
    """Return the mean over all φ from pairs and from every simulated figure.

    Args:
        y: physical figures, one of each φ.
        x: simulated figures of the same φ.
        population: simulated figures of all φ, those of the pairs among them.
        line: through the pairs; it has a slope.
        confidence: two-sided.
        wrong: trials in which the simulator was wrong that are added to the residuals (`figures.Figure`).
        reach: how many times as far as Student's the interval reaches; None: not further.

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
    value, error, residuals = regressed(y, x, population, line, left)
    return Mean(value, _interval(value, error, freedom, residuals, confidence, reach), error)


def regressed(
    y: FloatArray, x: FloatArray, population: FloatArray, line: Line, residual: float | None = None
) -> tuple[float, float, FloatArray]:
    """Return the regression estimator, its standard error and the residuals of the pairs; see the module.

    Args:
        y: physical figures.
        x: simulated figures of the same φ.
        population: simulated figures of all φ.
        line: through the pairs.
        residual: residual variance to take instead of the line's.
    """
    slope, centre = line.slope or 0.0, math.fsum(x) / x.size
    off = math.fsum(population) / population.size - centre
    residuals = y - math.fsum(y) / y.size - slope * (x - centre)
    left = line.residual if residual is None else residual
    squared = left * (1.0 / y.size + off * off / line.spread)
    squared += slope * slope * float(np.var(population, ddof=1)) / population.size
    return math.fsum(y) / y.size + slope * off, math.sqrt(squared), residuals


def stand_for_all(x: FloatArray, population: FloatArray) -> bool:
    """Return whether the φ with trials vary as all φ do in what is simulated of them.

    Where a few φ decide a mean, such as those on which the car all but hits, trials on others lie close together and on
    a line, and their interval is narrow and wrong. φ that were drawn by lot vary so little in one of twenty cases, by
    the χ² distribution of a variance.
    """
    return float(np.var(x, ddof=1)) >= least_variance(x.size) * float(np.var(population, ddof=1))


def least_variance(count: int) -> float:
    """Return the share of the variance over all φ that so many φ drawn by lot have in all but `SELDOM` of the cases."""
    freedom = count - 1.0
    return float(scipy.special.gammaincinv(0.5 * freedom, SELDOM)) * 2.0 / freedom


def trials_saved(pairs: int, narrower: float, confidence: float) -> int:
    """Return how many further φ of physical trials alone an interval as narrow would have taken.

    Args:
        pairs: φ with physical trials.
        narrower: width of the fused interval as a share of the one by the physical trials alone.
        confidence: of both.
    """

    def width(count: int) -> float:
        return student_quantile(count - 1.0, confidence) / math.sqrt(count)

    def enough(count: int) -> bool:
        return width(count) <= narrower * width(pairs)

    if enough(pairs):
        return 0
    low, high = pairs, 2 * pairs
    while not enough(high) and high < _MOST_TRIALS:
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if enough(middle) else (middle, high)
    return high - pairs


def _interval(
    value: float, error: float, freedom: float, residuals: FloatArray, confidence: float, reach: Reach | None
) -> Interval:
    """Return Student's interval, its end on the side of the residuals' long tail moved outwards."""
    quantile = student_quantile(freedom, checked_confidence(confidence))
    further = skewness(residuals) * (1.0 + 2.0 * quantile**2) / (6.0 * math.sqrt(residuals.size))
    times = reach or Reach()
    below = max(quantile * times.below, quantile - min(0.0, further))
    above = max(quantile * times.above, quantile + max(0.0, further))
    return value - below * error, value + above * error


def skewness(residuals: FloatArray) -> float:
    """Return the sample skewness G1 of numbers of mean 0 (D. N. Joanes and C. A. Gill, The Statistician 47, 1998)."""
    count, square = residuals.size, float(np.mean(residuals**2))
    if square <= 0.0:
        return 0.0
    ratio = float(np.mean(residuals**3)) / float(square**1.5)
    return ratio * math.sqrt(count * (count - 1.0)) / (count - 2.0)


def _centred(y: FloatArray, x: FloatArray) -> tuple[tuple[FloatArray, FloatArray], ...]:
    a, b = x - math.fsum(x) / x.size, y - math.fsum(y) / y.size
    return (a, a), (a, b), (b, b)


def _rounding(values: FloatArray) -> float:
    """Return a sum of squares that rounding alone may leave of numbers that are the same."""
    return float(values.size * (1e-9 * max(1e-300, float(np.abs(values).max()))) ** 2)
