"""How far an interval reaches for a figure of this shape: trials rehearsed on what the simulator says of all φ.

Student's quantile is right for normal figures. A clearance ends at 0 and has a long tail; a required deceleration is 0
on most φ and large on a few. Ten trials do not show such a shape, but thousands of simulated φ do. So the trials are
rehearsed: n φ drawn by lot from the simulated ones, again and again, each time with the estimate and its standard
error. Where the quantiles of (estimate − truth)/error lie further out than those of the same draws of normal figures,
the interval reaches as many times further: a bootstrap-t (B. Efron and R. J. Tibshirani, An Introduction to the
Bootstrap, 1993, section 12.5) that draws from the simulator's φ and not from the few trials.

What is assumed is a shape and no size: the physical figure, and what the simulator does not know of it, is over φ about
as skewed as the simulated figure, to the side to which the trials lean. Where φ with trials that are too much alike are
refused (`stand_for_all`), such draws are left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import special
from skd_sim.arrays import FloatArray

from skd_evaluator.metrics.statistics.statistics import checked_confidence

_DRAWS, _NUMBERS = 2000, 2_000_000
_LEAST = 200
"""Draws that have to be left to tell a quantile."""
_SEED = 28
_NOTHING = 1e-12


@dataclass(frozen=True)
class Reach:
    """How many times as far as Student's an interval reaches, at least 1.

    Attributes:
        below: from the estimate to the lower end.
        above: from the estimate to the upper end.
    """

    below: float = 1.0
    above: float = 1.0

    @property
    def further(self) -> float:
        """The greater of the two."""
        return max(self.below, self.above)


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
        return Reach()
    low, high = _quantiles(shape / deviation, count, confidence, by_line=by_line, least=least)
    normal_low, normal_high = _of_normal(shape.size, count, confidence, by_line=by_line, least=least)
    below, above = max(1.0, high / normal_high), max(1.0, low / normal_low)
    return Reach(above, below) if mirrored else Reach(below, above)


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
    estimate, squared = _by_line(unknown, known) if by_line else _by_itself(unknown)
    told = known.var(axis=1, ddof=1) >= max(_NOTHING, least)
    if int(told.sum()) < _LEAST // 2:
        return -math.inf, math.inf
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.where(squared > _NOTHING, estimate / np.sqrt(squared), np.copysign(math.inf, estimate))[told]
    tail = 0.5 - confidence / 2.0
    low, high = np.quantile(off, [tail, 1.0 - tail], method="higher")
    return float(low), float(high)


def _by_itself(unknown: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the mean of each row, of which the truth is 0, and its squared error."""
    return unknown.mean(axis=1), unknown.var(axis=1, ddof=1) / unknown.shape[1]


def _by_line(unknown: FloatArray, known: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the regression estimator of each row, of which the truth is 0, and its squared error."""
    count = unknown.shape[1]
    centre, mean = known.mean(axis=1), unknown.mean(axis=1)
    aside, off = known - centre[:, None], unknown - mean[:, None]
    spread = np.maximum((aside**2).sum(axis=1), _NOTHING)
    slope = (aside * off).sum(axis=1) / spread
    left = ((off - slope[:, None] * aside) ** 2).sum(axis=1) / (count - 2.0)
    return mean - slope * centre, left * (1.0 / count + centre**2 / spread)
