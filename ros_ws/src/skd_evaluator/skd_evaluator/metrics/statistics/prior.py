"""What is known of the φ of a distance before the first of them is seen, and the interval that follows.

Five φ say little of how φ differ. Three of four synthetic ones are straight crossings; five of these often hold none of
the others, are alike, and their mean is then too small and looks more certain than it is: Student's t misses the truth,
and from below. The five themselves do not show it. What other campaigns had in common does: how much φ differ, measured
by how much the trials on one φ do, and that a few φ ask for much more than the rest.

*How much they differ.* The values of φ number i are normal about a mean of their own with variance σ², and these means
normal about that of all φ with variance ρ·σ²: the one-way layout with random effects. Beforehand nothing is known of
the mean of all φ and of σ (p ∝ 1/σ²), and ln ρ has Student's t distribution with `FREEDOM` degrees about ln `ratio`,
`spread` wide: so wide a tail gives way to what φ show themselves (Gelman, Bayesian Analysis 1, 2006, on such priors).
The posterior of the mean is a mixture over ρ of Student's distributions (Box and Tiao, Bayesian Inference in
Statistical Analysis, 1973, section 5.2), and the interval holds the middle of it.

*That they are skewed.* The end on the side of the skewness is moved out by the term that Cornish and Fisher's expansion
has for φ means of that skewness (Johnson, Journal of the American Statistical Association 73, 1978), which is taken as
the one beforehand and the sample's together: of five values the sample's alone is a third of what it should be.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy
from skd_sim.arrays import FloatArray

from skd_evaluator.metrics.statistics.statistics import Interval

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
        self,
        means: FloatArray,
        counts: FloatArray,
        inside: float,
        confidence: float,
        precision: float = EXACT,
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
        wanted, parts = 0.5 + confidence / 2.0, shares[kept] / shares[kept].sum()
        low, high = scipy.special.stdtrit(freedom, wanted) * np.array([0.5 * errors.min(), 2.0 * errors.max()])

        def beyond(reach: float) -> float:
            return float(parts @ scipy.special.stdtr(freedom, reach / errors) - wanted)

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
"""Of deviation and Fréchet distance; docs/decisions.md has where the numbers are from."""
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
