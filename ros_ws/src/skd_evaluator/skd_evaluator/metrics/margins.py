"""The margin of a car: the least deviation with which anybody could have been hit by the moving car, on average.

Each trial, a safe trajectory φ and one set of draws, has a least deviation of its own. It is clairvoyant: who walks
that way knows beforehand how the car will be noisy. So the mean says how much room there is, and not how often somebody
is hit. A trial in which nobody can be hit within η_max counts as η_max (the restricted mean of `mean_deviation`).

The margin of a car and what is reported with it, from the margins of its trials.

The margin of a trial is the least deviation with which anybody could have been hit by the moving car; a trial
in which nobody could within η_max counts as η_max. Their mean over all trials is the margin of the car: the
restricted mean, as that of the planned deviation (`mean_deviation`), and the area above the curve of P(η), the
share of trials whose margin is at most η.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from statistics import NormalDist
from typing import Any

import numpy as np
import numpy.typing as npt
from skd_sim.arrays import FloatArray

from skd_evaluator.metrics.clustered import MARGINS, Clustered, clustered_mean
from skd_evaluator.metrics.deviation import LeastWay
from skd_evaluator.metrics.statistics import Interval, mean, ratio_interval
from skd_evaluator.metrics.vulnerability_curve import VulnerabilityCurve, vulnerability_curve

GAP_WARNING = 1.5
"""Optimality gap above which the planned figures say more about the adversary than about the car."""
UPPER_BOUNDS = ("margin", "margin_p10", "equivalent_multiplier")
"""Figures that are greater where the search stops too early: upper bounds until it has converged."""
CONVERGED_WITHIN = 0.025
"""Of the mean: how much too high the margin of a search that has converged may be."""
_ROUNDING = 1e-9  # m: a mean margin that is not above it is 0


@dataclass(frozen=True)
class Excess:
    """How much too high the mean of a search may still be, estimated from trials that were searched much deeper.

    Attributes:
        mean: m, ≥ 0.
        error: standard error of `mean`, m.
        trials: how many were searched deeper.
    """

    mean: float
    error: float
    trials: int


@dataclass(frozen=True, eq=False)
class Margins:
    """The least ways of all trials, and what is reported of them.

    Attributes:
        ways: for each φ the least way of each trial, in the order of their numbers; None: nobody can be hit within
            η_max, or no such way was found.
        eta_max: η_max, m: what a trial counts as in which nobody can be hit.
        budget: candidates that the search drove in a trial; None: the margins are exact.
        converged: whether the mean may be taken for the margin, see `skd_evaluator.margin.search.search`; else it is an
            upper bound. Exact ones are.
        excess: how much too high the mean may be; None: not at all, or nothing says.
        confidence: confidence of the intervals over φ.
        how: what was driven, in a few words, if it was not the car itself in this process; else empty.
    """

    ways: tuple[tuple[LeastWay | None, ...], ...]
    eta_max: float
    budget: int | None = None
    converged: bool = True
    excess: Excess | None = None
    confidence: float = 0.95
    how: str = ""

    @cached_property
    def per_phi(self) -> tuple[FloatArray, ...]:
        """Margin of each trial, per φ, m; η_max where nobody can be hit within it."""
        return tuple(
            np.array([self.eta_max if way is None else min(way.distance, self.eta_max) for way in ways])
            for ways in self.ways
        )

    @property
    def values(self) -> FloatArray:
        """Margin of every trial, φ by φ, m."""
        return np.concatenate([np.empty(0), *self.per_phi])

    @property
    def mean(self) -> float:
        """The margin, m."""
        return mean(self.values)

    @cached_property
    def _figures(self) -> MarginFigures | None:
        return margin_figures(self.per_phi, self.eta_max, confidence=self.confidence)

    @cached_property
    def clustered(self) -> Clustered | None:
        """The margin with what its error over φ is."""
        return None if self._figures is None else self._figures.clustered

    @property
    def ci95(self) -> Interval | None:
        """Interval of the margin over φ, m, down to what the search may have missed; None below two φ."""
        if self.clustered is None or self.clustered.interval is None:
            return None
        low, high = self.clustered.interval
        if self.excess is None:
            return low, high
        z = NormalDist().inv_cdf(0.5 + 0.5 * self.confidence)
        below = math.hypot(self.mean - low, z * self.excess.error) + self.excess.mean
        return max(0.0, self.mean - below), high

    @property
    def exact(self) -> bool:
        """Whether they were computed, and not searched for."""
        return self.budget is None

    @property
    def gap(self) -> float | None:
        """The margin is no more than this above the least that is possible, m; None: that is not known."""
        gaps = np.array([0.0 if way is None else way.gap for ways in self.ways for way in ways])
        return mean(gaps) if self.exact and gaps.size and np.isfinite(gaps).all() else None

    @property
    def curve(self) -> VulnerabilityCurve | None:
        """The vulnerability curve: how often somebody who strays at most η could be hit."""
        return None if self._figures is None else self._figures.curve

    @property
    def impact_speeds(self) -> FloatArray:
        """Speed of the car at the contact of each way that there is, m/s."""
        return np.array([way.impact_speed for ways in self.ways for way in ways if way is not None])

    @property
    def beyond(self) -> int:
        """Trials in which nobody is hit within η_max, as far as was found."""
        return sum(way is None for ways in self.ways for way in ways)

    def figures(self) -> dict[str, Any]:
        """Return the entries of assessment.json."""
        speeds = self.impact_speeds
        return {
            "margin": self.mean,
            "margin_ci95": self.ci95,
            "margin_p10": float(np.quantile(self.values, 0.1)),
            "margin_converged": self.converged,
            "margin_budget": self.budget,
            "margin_excess": None if self.excess is None else asdict(self.excess),
            "margin_gap": self.gap,
            "margin_trials": int(self.values.size),
            "margin_beyond": self.beyond,
            "margin_how": self.how,
            "impact_speed": impact_figures(speeds),
        }


def stopped_at(figures: Mapping[str, Any]) -> str:
    """Return, of a search that has not converged, where it stopped, from the content of assessment.json."""
    return f"had not converged at {figures['margin_budget']} candidates a trial"


def open_search(figures: Mapping[str, Any]) -> list[str]:
    """Return, in one line, that a margin is an upper bound; nothing where the search has converged."""
    if figures.get("margin_converged") is not False:
        return []
    return [f"the margin is at most {figures['margin']:.3f} m, for its search {stopped_at(figures)}"]


def impact_figures(speeds: FloatArray) -> dict[str, float] | None:
    """Return mean and 90 % quantile of impact speeds, m/s; None without any."""
    if not speeds.size:
        return None
    return {"mean": mean(speeds), "p90": float(np.quantile(speeds, 0.9))}


def optimality_gap(
    planned: Sequence[FloatArray], margins: Sequence[FloatArray], confidence: float = 0.95
) -> tuple[float | None, Interval | None]:
    """Return how many times the margin planned kamikazes needed, in the same trials, and its interval.

    Args:
        planned: for each φ, what each trial of the kamikazes counts as, m (η_max if it failed); nan: it does not
            count.
        margins: for each φ, the margins of the same trials, m.
        confidence: confidence of the interval, which is over φ (ratio estimator), or over trials if there is one φ.

    Returns:
        The ratio of the means and its interval; None where the margin is 0, or no trial counts.

    Raises:
        ValueError: the lists do not go together.
    """
    above, below = [], []
    for mine, least in zip(planned, margins, strict=True):
        known = np.isfinite(mine)
        if known.any():
            above.append(mine[known])
            below.append(least[known])
    if not above or mean(np.concatenate(below)) <= _ROUNDING:
        return None, None
    value = mean(np.concatenate(above)) / mean(np.concatenate(below))
    means = [np.array([mean(one) for one in side]) for side in (above, below)]
    items = means if len(above) > 1 else [above[0], below[0]]
    interval = ratio_interval(items[0], items[1], confidence) if math.isfinite(value) else None
    return value, interval


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
