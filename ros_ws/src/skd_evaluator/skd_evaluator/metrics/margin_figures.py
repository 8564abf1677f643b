"""The margin of a car and what is reported with it, from the margins of its trials.

The margin of a trial is the least deviation with which anybody could have been hit by the moving car; a trial
in which nobody could within η_max counts as η_max. Their mean over all trials is the margin of the car: the
restricted mean, as that of the planned deviation (`mean_deviation`), and the area above the curve of P(η), the
share of trials whose margin is at most η.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from skd_sim.arrays import FloatArray

from skd_evaluator.metrics.statistics.clustered import Clustered, clustered_mean
from skd_evaluator.metrics.statistics.prior import MARGINS
from skd_evaluator.metrics.statistics.statistics import Interval
from skd_evaluator.metrics.vulnerability_curve import VulnerabilityCurve, vulnerability_curve

_BEYOND = 1e-9  # m, by which a margin may be above η_max: rounding


@dataclass(frozen=True, eq=False)
class MarginFigures:
    """The margin of a car.

    Attributes:
        groups: for each φ the margins of the trials that were not aborted, m, in [0, η_max].
        clustered: their mean, m, with what is known of its error over φ.
        curve: the vulnerability curve.
        eta_max: η_max, m: what a trial counts as in which nobody can be hit.
        aborted: number of trials that were aborted.
    """

    groups: tuple[FloatArray, ...]
    clustered: Clustered
    curve: VulnerabilityCurve
    eta_max: float
    aborted: int = 0

    @property
    def margin(self) -> float:
        """Mean over all trials, m."""
        return self.clustered.value

    @property
    def ci95(self) -> Interval | None:
        """Its interval by φ, m: of the mean over all φ of this kind; None below two φ with trials."""
        return self.clustered.interval


def margin_figures(
    groups: Sequence[npt.ArrayLike], eta_max: float, *, confidence: float = 0.95
) -> MarginFigures | None:
    """Return the margin of a car.

    Args:
        groups: for each φ the margin of each trial, m, in [0, η_max]; infinity where nobody could be hit; nan:
            aborted.
        eta_max: η_max, m, > 0.
        confidence: confidence of the interval by φ.

    Returns:
        None without a trial that counts.

    Raises:
        ValueError: a margin is negative, or finite and above η_max, or η_max is not positive and finite.
    """
    if not 0.0 < eta_max < math.inf:
        raise ValueError(f"η_max must be positive and finite, got {eta_max}")
    kept, aborted = [], 0
    for group in groups:
        values = np.asarray(group, dtype=np.float64)
        if values.ndim != 1:
            raise ValueError(f"the margins of a φ must be a plain list of numbers, got shape {values.shape}")
        known = values[~np.isnan(values)]
        aborted += values.size - known.size
        if (known < 0.0).any() or (known[np.isfinite(known)] > eta_max + _BEYOND).any():
            raise ValueError(f"margins must be from 0 to η_max = {eta_max:g} m, infinite where nobody could be hit")
        kept.append(np.minimum(known, eta_max))
    curve = vulnerability_curve(kept, eta_max)
    found = clustered_mean(kept, confidence, prior=MARGINS, limits=(0.0, eta_max))
    if curve is None or found is None:
        return None
    return MarginFigures(tuple(kept), found, curve, eta_max, aborted)
