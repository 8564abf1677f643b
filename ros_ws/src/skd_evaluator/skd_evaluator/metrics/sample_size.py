"""How many safe trajectories, and how many kamikazes for each, a wanted certainty takes.

From the variances between and within φ of an earlier assessment follows how wide the interval of another will be,
and how likely it finds a difference: with m φ and n trials on each the squared error of a mean is
(between + within / n) / m. More trials on the same φ only help until `between` is left.

Looking again and again at figures that grow: intervals that hold together at every look.

If one goes on until an interval is narrow enough, and looks each time, one stops where chance made it narrow: a 95 %
interval then holds less often than it says. Repeated confidence intervals (Jennison and Turnbull, Journal of the Royal
Statistical Society B 51, 1989) hold at all looks together with the confidence stated, and so at whichever one stops.
Each is an ordinary interval of a higher, nominal confidence: the one that Pocock's test (Biometrika 64, 1977) has for
so many looks at equal distances. With Student's t in the place of the normal distribution that is the significance
level approach of Jennison and Turnbull (Group Sequential Methods, 2000, section 11.5).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from skd_sim.world.state import FloatArray

from skd_evaluator.metrics.clustered import Clustered, Prior, student_quantile
from skd_evaluator.metrics.entry import Entry
from skd_evaluator.metrics.statistics import Interval

MOST = 10_000
"""Greatest number of φ that is advised."""
_MANY = 60
"""φ beyond which an interval with what was known beforehand is Student's, but for a percent."""
_FEW_NODES, _FEW_WEIGHTS = np.polynomial.legendre.leggauss(16)
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(200)
_PRECISION = 1e-4
"""Relative error of a width that is planned with: a hundredth of what is shown of it."""
COUNTS = (10, 20, 25, 50, 100, 200, 400)
"""Trials on each φ that are offered."""


@dataclass(frozen=True)
class Size:
    """A campaign's size and what it gives.

    Attributes:
        safe: number of φ.
        trials: number of trials on each φ.
        width: expected width of the interval, in the unit of the values.
        power: chance that a difference is found; None where none was asked about.
    """

    safe: int
    trials: int
    width: float
    power: float | None = None

    @property
    def episodes(self) -> int:
        """Kamikaze episodes of one objective."""
        return self.safe * self.trials


def expected_width(between: float, within: float, safe: int, trials: int, *, prior: Prior | None = None) -> float:
    """Return how wide the 95 % interval over φ is expected to be.

    Args:
        between: variance of the φ's own means.
        within: variance of the values of one φ.
        safe: number of φ, ≥ 2.
        trials: number of trials on each φ, ≥ 1.
        prior: what the interval takes as known beforehand. With many φ it makes no difference, and is left out.
    """
    error, inside = math.sqrt((between + within / trials) / safe), within * safe * (trials - 1.0)
    if prior is None or not prior.can_tell(inside) or safe > _MANY:
        return 2.0 * student_quantile(safe - 1.0) * error * mean_of_root(safe - 1.0)
    counts = np.full(safe, float(trials))
    # Means whose sample has no skewness and the variance 1, and the values that their estimated variance may take.
    means = np.linspace(-1.0, 1.0, safe)
    means /= means.std(ddof=1)
    freedom = safe - 1.0
    scales = np.sqrt(safe * scipy.special.gammaincinv(freedom / 2.0, 0.5 + 0.5 * _FEW_NODES) * 2.0 / freedom) * error
    reaches = [prior.interval(scale * means, counts, inside, 0.95, _PRECISION) for scale in scales]
    widths = np.array([sum(reach) for reach in reaches if reach is not None])
    return float(0.5 * _FEW_WEIGHTS @ widths)


def mean_of_root(freedom: float) -> float:
    """Return the mean of an estimated standard error over the true one: √(χ²/ν) has it below 1."""
    return math.sqrt(2.0 / freedom) * math.exp(math.lgamma((freedom + 1.0) / 2.0) - math.lgamma(freedom / 2.0))


def power(difference: float, between: float, within: float, safe: int, trials: int, *, paired: bool) -> float:
    """Return the chance that a difference of two cars is found at the 5 % level, by noncentral t.

    Args:
        difference: difference of the means, in the unit of the values.
        between: variance between φ: with `paired`, of the differences on each φ; else of each car's means.
        within: variance of one trial on a φ: with `paired`, of the difference of two trials with one number.
        safe: number of φ of each car, ≥ 2.
        trials: number of trials on each φ.
        paired: whether both cars face the same φ.
    """
    samples = 1 if paired else 2
    error = math.sqrt(samples * (between + within / trials) / safe)
    if error == 0.0:
        return 1.0 if difference else 0.05
    freedom = samples * (safe - 1.0)
    bound, shift = student_quantile(freedom), abs(difference) / error
    # Over the quantiles of the estimated error, for scipy's noncentral t is undefined where the shift is large.
    spread = bound * np.sqrt(scipy.special.gammaincinv(freedom / 2.0, 0.5 + 0.5 * _NODES) * 2.0 / freedom)
    return float(0.5 * _WEIGHTS @ (scipy.special.ndtr(shift - spread) + scipy.special.ndtr(-shift - spread)))


def sizes_for_width(
    width: float, between: float, within: float, *, prior: Prior | None = None, counts: Sequence[int] = COUNTS
) -> list[Size]:
    """Return for each number of trials the least number of φ whose interval is expected to be so narrow.

    Those that no number of φ up to `MOST` suffices for are left out.
    """

    def found(safe: int, trials: int) -> Size:
        return Size(safe, trials, expected_width(between, within, safe, trials, prior=prior))

    return _least(counts, found, lambda size: size.width <= width)


def sizes_for_power(
    difference: float,
    least_power: float,
    between: float,
    within: float,
    *,
    paired: bool,
    counts: Sequence[int] = COUNTS,
) -> list[Size]:
    """Return for each number of trials the least number of φ that shows a difference with this power."""

    def found(safe: int, trials: int) -> Size:
        samples = 1 if paired else 2
        wide = expected_width(samples * between, samples * within, safe, trials)
        return Size(safe, trials, wide, power(difference, between, within, safe, trials, paired=paired))

    return _least(counts, found, lambda size: size.power is not None and size.power >= least_power)


def _least(counts: Sequence[int], found: Callable[[int, int], Size], enough: Callable[[Size], bool]) -> list[Size]:
    """Return for each number of trials the size with the least number of φ that is enough: more φ always are."""
    sizes = []
    for trials in counts:
        if not enough(found(MOST, trials)):
            continue
        low, high = 1, MOST
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if enough(found(middle, trials)) else (middle, high)
        sizes.append(found(high, trials))
    return sizes


MOST_LOOKS = 100
"""Looks for which the integral is right to ten digits. Its nodes are spread over ± bound·√looks, and from some 150 on
they lie so far apart that the confidence falls again: with 1,000 looks it would be less than that of one."""
_QUADRATURE = 100
_STEPS = 48  # of the bisection: to 1e-13


@functools.cache
def nominal_confidence(looks: int) -> float:
    """Return the confidence that each of several looks needs for all of them together to have 95 %.

    Args:
        looks: greatest number of looks, after equal amounts of data, from 1 to `MOST_LOOKS`.

    Raises:
        ValueError: no look, or more than `MOST_LOOKS`.
    """
    if not 1 <= looks <= MOST_LOOKS:
        raise ValueError(f"there must be at least one look, and at most {MOST_LOOKS}, got {looks}")
    low, high = 0.0, 10.0
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _held(middle, looks) < 0.95 else (low, middle)
    return float(scipy.special.ndtr(high) - scipy.special.ndtr(-high))


def _held(bound: float, looks: int) -> float:
    """Return how likely sums of standard normal numbers stay within ± bound·√k after each k of `looks`.

    By the recursion of Armitage, McPherson and Rowe (1969), integrated with Gauss and Legendre's rule.
    """
    nodes, weights = _rule()
    places, shares = bound * nodes, bound * weights
    density = _normal(places)
    for look in range(2, looks + 1):
        reach = bound * math.sqrt(look)
        further = reach * nodes
        density = _normal(further[:, None] - places[None, :]) @ (shares * density)
        places, shares = further, reach * weights
    return float(shares @ density)


@functools.cache
def _rule() -> tuple[FloatArray, FloatArray]:
    nodes, weights = np.polynomial.legendre.leggauss(_QUADRATURE)
    return nodes, weights


def _normal(places: FloatArray) -> FloatArray:
    return np.exp(-0.5 * places**2) / math.sqrt(2.0 * math.pi)


@dataclass(frozen=True)
class Look(Entry):
    """What was known at one look.

    Attributes:
        safe_count: φ by then.
        found: the mean planned deviation by then; None without a trial.
    """

    KEYS = "safe_count deviation interval"

    safe_count: int
    found: Clustered | None

    @property
    def deviation(self) -> float | None:
        """Planned deviation by then, m."""
        return None if self.found is None else self.found.value

    @property
    def interval(self) -> Interval | None:
        """Interval of it over φ, m."""
        return None if self.found is None else self.found.interval


@dataclass(frozen=True)
class UntilWidth(Entry):
    """When an assessment stopped, and why.

    Attributes:
        requested: width of the interval of the mean deviation, m.
        most_looks: at most so many looks.
        confidence: confidence of each look's interval, such that all together hold with 95 %.
        looks: each look.
    """

    KEYS = "requested reached text most_looks confidence looks"

    requested: float
    most_looks: int
    confidence: float
    looks: tuple[Look, ...]

    @property
    def width(self) -> float | None:
        """Width at the last look, m; None without an interval."""
        return _width(self.looks[-1].found)

    @property
    def reached(self) -> bool:
        """Whether the interval is narrow enough."""
        return narrow_enough(self.looks[-1].found, self.requested)

    @property
    def text(self) -> str:
        """What came of it, in words."""
        count, width = self.looks[-1].safe_count, self.width
        now = "there is none" if width is None else f"it is {width:.3f} m wide"
        end = "" if self.reached else f", not {self.requested:g} m as requested: give more φ a batch (--safe-count)"
        holds = f"intervals by φ hold at all {self.most_looks} looks together"
        return f"after {count} φ the interval of the deviation: {now}{end}; {holds}"


def narrow_enough(found: Clustered | None, width: float) -> bool:
    """Return whether an interval is as narrow as this. One without any width is luck, and says nothing."""
    found_width = _width(found)
    return found_width is not None and 0.0 < found_width <= width


def _width(found: Clustered | None) -> float | None:
    return None if found is None or found.interval is None else found.interval[1] - found.interval[0]
