"""The margin of a car: the least deviation with which a road user could have been hit by the moving car, on average.

Each trial, a safe trajectory φ and one set of draws, has a least deviation of its own. It is clairvoyant: who walks
that way knows beforehand how the car will be noisy. So the mean says how much room there is, and not how often one
is hit. A trial in which none can be hit within η_max counts as η_max (the restricted mean of `mean_deviation`): the
margin is the area above the curve of P(η), the share of trials whose margin is at most η.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from statistics import NormalDist
from typing import Any

import numpy as np
from skd_sim.arrays import FloatArray

from skd_evaluator.metrics.clustered import MARGINS, Clustered, clustered_mean
from skd_evaluator.metrics.deviation import Hit
from skd_evaluator.metrics.entry import Entry
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
class Excess(Entry):
    """How much too high the mean of a search may still be, estimated from trials that were searched much deeper.

    Attributes:
        mean: m, ≥ 0.
        error: standard error, m.
        trials: trials that were searched deeper.
    """

    KEYS = "mean error trials"

    mean: float
    error: float
    trials: int


@dataclass(frozen=True)
class Search:
    """How margins were searched for, and how good they are.

    Attributes:
        budget: candidates a trial.
        converged: whether the mean may be taken for the margin, see `skd_evaluator.margin.search.search`; else it is an
            upper bound.
        excess: how much too high the mean may be; None: no trial was searched deeper.
        sources: of each source of candidates how many it gave, how many of them were better hits than the best known,
            and by how much they lowered margins, summed over trials, m.
        how: what was driven, in a few words, if it was not the car itself in this process; else empty.
    """

    budget: int
    converged: bool
    excess: Excess | None = None
    sources: tuple[Mapping[str, Any], ...] = ()
    how: str = ""


@dataclass(frozen=True, eq=False)
class Margins:
    """The hits of least deviation of all trials, and what is reported of them.

    Attributes:
        hits: for each φ the hit of least deviation of each trial, in the order of their numbers; None: none can be
            hit within η_max, or no hit was found.
        eta_max: η_max, m: what a trial without a hit counts as.
        search: how they were searched for; None: the margins are exact.
        confidence: confidence of the intervals over φ.
    """

    hits: tuple[tuple[Hit | None, ...], ...]
    eta_max: float
    search: Search | None = None
    confidence: float = 0.95

    @cached_property
    def per_phi(self) -> tuple[FloatArray, ...]:
        """Margin of each trial, per φ, m; η_max without a hit within it."""
        return tuple(
            np.array([self.eta_max if hit is None else min(hit.distance, self.eta_max) for hit in hits])
            for hits in self.hits
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
    def clustered(self) -> Clustered | None:
        """The margin with what its error over φ is."""
        return clustered_mean(self.per_phi, self.confidence, prior=MARGINS, limits=(0.0, self.eta_max))

    @property
    def ci95(self) -> Interval | None:
        """Interval of the margin over φ, m, down to what the search may have missed; None below two φ."""
        if self.clustered is None or self.clustered.interval is None:
            return None
        low, high = self.clustered.interval
        excess = self.search.excess if self.search is not None else None
        if excess is None:
            return low, high
        z = NormalDist().inv_cdf(0.5 + 0.5 * self.confidence)
        below = math.hypot(self.mean - low, z * excess.error) + excess.mean
        return max(0.0, self.mean - below), high

    @property
    def exact(self) -> bool:
        """Whether they were computed, and not searched for."""
        return self.search is None

    @property
    def converged(self) -> bool:
        """Whether the mean may be taken for the margin."""
        return self.search is None or self.search.converged

    @property
    def gap(self) -> float | None:
        """The margin is no more than this above the least that is possible, m; None: that is not known."""
        gaps = np.array([0.0 if hit is None else hit.gap for hits in self.hits for hit in hits])
        return mean(gaps) if self.exact and gaps.size and np.isfinite(gaps).all() else None

    @property
    def curve(self) -> VulnerabilityCurve | None:
        """The vulnerability curve: how often a road user who strays at most η could be hit."""
        return vulnerability_curve(self.per_phi, self.eta_max)

    @property
    def impacts(self) -> tuple[FloatArray, ...]:
        """Per φ the car's speed at the hit of each trial, m/s; nan without one."""
        return tuple(np.array([math.nan if hit is None else hit.impact_speed for hit in hits]) for hits in self.hits)

    @property
    def impact_speeds(self) -> FloatArray:
        """Speed of the car at the contact of each hit, m/s."""
        return np.array([hit.impact_speed for hits in self.hits for hit in hits if hit is not None])

    @property
    def beyond(self) -> int:
        """Trials without a hit within η_max, as far as was found."""
        return sum(hit is None for hits in self.hits for hit in hits)

    def quantile(self, share: float) -> float:
        """Return the margin that a share of the trials do not exceed, m."""
        return float(np.quantile(self.values, share))

    @property
    def impact_speed(self) -> dict[str, float] | None:
        """Mean and 90 % quantile of the impact speeds, m/s; None without a hit."""
        return impact_figures(self.impact_speeds)


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
