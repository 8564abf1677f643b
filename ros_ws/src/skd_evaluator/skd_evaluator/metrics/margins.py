"""The margin of a car: the least deviation with which a road user could have been hit by the moving car, on average.

Each trial, a safe trajectory φ and one set of draws, has a least deviation of its own. It is clairvoyant: who walks
that way knows beforehand how the car will be noisy. So the mean says how much room there is, and not how often one
is hit. A trial in which none can be hit within η_max counts as η_max (the restricted mean of `mean_deviation`): the
margin is the area above the curve of P(η), the share of trials whose margin is at most η.

The equivalent multiplier: the C of the basic car that has the same margin on the same safe trajectories.

The margin of the basic car rises with C. It is compared trial by trial, car less basic car: a trial is one φ and
one set of draws, which both cars share, so most of the chance cancels. The mean difference falls as C rises, except for
chance; so it is made monotone (isotonic regression, weighted by trials: Barlow et al. 1972), joined by straight
lines, and C is where it passes 0.

The interval holds every C at which the difference is not significant: the test is inverted, as in Fieller's
interval for a ratio (Fieller, Journal of the Royal Statistical Society B 16, 1954). The test is that of two cars on the
same φ, Student's with the cluster-robust error over φ (`clustered_mean`). So it speaks of all φ of this kind, and the
second one, which takes φ as given and draws trials only, of these φ.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from statistics import NormalDist
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy
from skd_sim.world.state import FloatArray

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
        lanes: of a car that leaves its lane: the margin with the oncoming lane in each of its states, m, the lower one
            first, which these are of.
    """

    hits: tuple[tuple[Hit | None, ...], ...]
    eta_max: float
    search: Search | None = None
    confidence: float = 0.95
    lanes: Mapping[str, float] = field(default_factory=dict)

    @property
    def lane(self) -> str:
        """State of the oncoming lane that they are of; empty: as in the scenario."""
        return next(iter(self.lanes), "")

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
    def beyond(self) -> int:
        """Trials without a hit within η_max, as far as was found."""
        return sum(hit is None for hits in self.hits for hit in hits)

    def quantile(self, share: float) -> float:
        """Return the margin that a share of the trials do not exceed, m."""
        return float(np.quantile(self.values, share))

    @property
    def impact_speed(self) -> dict[str, float] | None:
        """Mean and 90 % quantile of the impact speeds, m/s; None without a hit."""
        return impact_figures(np.array([hit.impact_speed for hits in self.hits for hit in hits if hit is not None]))


SEARCHED_BY = {"whole episodes": 8, "episodes of held commands": 64}
"""How a search says in `margin_how` what it drove: how many candidates of --margin-limit one of them counts for."""


def longer_search(figures: Mapping[str, Any]) -> str:
    """Return what to do about a search that has not converged: twice its limit, and at least the default."""
    how = figures.get("margin_how") or ""
    times = next((candidates for driven, candidates in SEARCHED_BY.items() if driven in how), 1)
    return f"give --margin-limit {max(1024, 2 * times * figures['margin_budget'])}"


def stopped_at(figures: Mapping[str, Any]) -> str:
    """Return, of a search that has not converged, where it stopped, from the content of assessment.json."""
    why, excess = "", (figures.get("margin_excess") or {}).get("mean", 0.0)
    if beyond := figures.get("margin_beyond"):  # with which no search converges
        why = f" (no hit in {beyond} of {figures['margin_trials']} trials)"
    elif excess > CONVERGED_WITHIN * figures.get("margin", 0.0):
        why = f" ({excess:.3f} m too high, by trials searched deeper)"
    budget = figures["margin_budget"]
    return f"had not converged at {budget} candidate{'s' * (budget != 1)} a trial{why}"


def lane_of_margin(figures: Mapping[str, Any]) -> str:
    """Return the state of the oncoming lane that a margin is of, from assessment.json; empty: as in the scenario."""
    return next(iter(figures.get("margin_lanes") or ()), "")


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


@dataclass(frozen=True)
class EquivalentMultiplier:
    """C, or on which side of the multipliers that were compared it would lie.

    Attributes:
        value: C; minus or plus infinity below or above `lowest` or `highest`.
        ci95: 95 % interval by φ: what other φ of this kind might have said; an end beyond is infinite. None with one φ.
        ci95_trials: 95 % interval for these φ, over the draws of their trials; None where no φ has two.
        lowest: the multiplier of which `below` is said.
        highest: the multiplier of which `above` is said.
    """

    value: float
    ci95: Interval | None
    ci95_trials: Interval | None
    lowest: float
    highest: float

    @property
    def text(self) -> str:
        """C as people read it: a number, `below 0.5` or `above 1.5`."""
        return self._side(self.value) or f"{self.value:.3f}"

    def interval_text(self, interval: Interval) -> str:
        """Return an interval as people read it; an end beyond all multipliers is called `above` or `below`."""
        return f"[{', '.join(self._side(end) or f'{end:.3f}' for end in interval)}]"

    def _side(self, value: float) -> str:
        if math.isfinite(value):
            return ""
        return f"above {self.highest:g}" if value > 0.0 else f"below {self.lowest:g}"


def equivalent_entries(found: EquivalentMultiplier | None) -> dict[str, Any]:
    """Return the entries of assessment.json; what lies beyond is null there, and the texts say where."""
    name = "equivalent_multiplier"
    if found is None:
        ends = ("", "_text", "_ci95", "_ci95_these_phi", "_ci95_text", "_ci95_these_phi_text")
        return dict.fromkeys(f"{name}{end}" for end in ends)
    entries: dict[str, Any] = {name: _finite(found.value), f"{name}_text": found.text}
    for key, interval in (("ci95", found.ci95), ("ci95_these_phi", found.ci95_trials)):
        entries[f"{name}_{key}"] = interval and [_finite(end) for end in interval]
        entries[f"{name}_{key}_text"] = interval and found.interval_text(interval)
    return entries


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


@dataclass(frozen=True)
class MarginDifference:
    """How much more margin a car has than the basic car of one C.

    Attributes:
        mean: mean difference over all trials, m.
        ci95: 95 % interval by φ, m; None with fewer than two φ.
        ci95_trials: 95 % interval over the trials of these φ, m; None where no φ has two.
        trials: how many trials both cars have.
    """

    mean: float
    ci95: Interval | None
    ci95_trials: Interval | None
    trials: int


@dataclass(frozen=True)
class ReferenceMargin(Entry):
    """How a car stands beside a reference driver.

    Attributes:
        driver: name of the driver, as for `--controller`.
        margin: its margin in the car's trials, m.
        difference: mean difference of the margins, car less driver, m.
        difference_ci95: 95 % interval of it by φ, m.
        trials: how many trials both have.
        bounds: whether the margins of the car and of the driver are upper bounds.
    """

    KEYS = "driver margin difference difference_ci95 trials verdict"
    driver: str
    margin: float
    difference: float
    difference_ci95: Interval
    trials: int
    bounds: tuple[bool, bool] = (False, False)

    @property
    def verdict(self) -> str:
        """What the car is: `safer than`, `less safe than` or `not told apart from` the driver."""
        low, high = self.difference_ci95
        of_car, of_driver = self.bounds
        if low > 0.0 and not of_car:
            return VERDICTS[0]
        return VERDICTS[2] if high < 0.0 and not of_driver else VERDICTS[1]


VERDICTS = ("safer than", "not told apart from", "less safe than")


def reference_text(found: Sequence[Mapping[str, Any]]) -> str:
    """Return in a line between which reference drivers a car stands, from the entries of assessment.json."""
    drivers = {verdict: [one["driver"] for one in found if one["verdict"] == verdict] for verdict in VERDICTS}
    return "; ".join(f"{verdict} {', '.join(names)}" for verdict, names in drivers.items() if names)


def difference(car: Sequence[npt.ArrayLike], basic: Sequence[npt.ArrayLike]) -> MarginDifference | None:
    """Return the difference of two cars' margins, by trials that both have.

    Args:
        car: for each φ the margins of the car's trials, in the order of their numbers, m; nan: the trial says
            nothing.
        basic: the same for the basic car; it may have fewer trials.

    Returns:
        None without a trial in common.
    """
    groups = []
    for one, other in zip(car, basic, strict=True):
        first, second = np.asarray(one, dtype=np.float64), np.asarray(other, dtype=np.float64)
        common = min(len(first), len(second))
        values = first[:common] - second[:common]
        groups.append(values[~np.isnan(values)])
    found = clustered_mean(groups)
    if found is None:
        return None
    return MarginDifference(found.value, found.interval, _within(groups), found.values)


def _within(groups: Sequence[FloatArray]) -> Interval | None:
    """Return the interval of the mean over all values for these φ: only the trials on each are taken as a sample."""
    filled = [one for one in groups if one.size]
    total, spread = sum(one.size for one in filled), [one for one in filled if one.size > 1]
    if not spread:
        return None
    freedom = sum(one.size - 1 for one in spread)
    variances = [math.fsum((one - mean(one)) ** 2) / (one.size - 1) for one in spread]
    typical = math.fsum(variances) / len(variances)  # of a φ with a single trial
    known = math.fsum(variance * one.size for variance, one in zip(variances, spread, strict=True))
    error = math.sqrt(known + typical * (len(filled) - len(spread))) / total
    reach, centre = float(scipy.special.stdtrit(freedom, 0.975)) * error, mean(np.concatenate(filled))
    return centre - reach, centre + reach


def equivalent_multiplier(
    car: Sequence[npt.ArrayLike], basic: Mapping[float, Sequence[npt.ArrayLike]]
) -> EquivalentMultiplier:
    """Return the multiplier of the basic car that has the margin of a car on these φ.

    Args:
        car: for each φ the margins of the car's trials, in the order of their numbers, m, at most η_max; nan: the
            trial says nothing, because it was aborted, say.
        basic: for at least two C the margins of the basic car in the same trials; it may have fewer of them.

    Raises:
        ValueError: one C is without a trial in common with the car.
    """
    grid = np.array(sorted(basic))
    found = []
    for multiplier in grid.tolist():
        one = difference(car, basic[multiplier])
        if one is None:
            raise ValueError(f"the basic car with C = {multiplier:g} has no trial in common with the car")
        found.append(one)
    counts = np.array([one.trials for one in found], dtype=np.float64)
    rising = -np.array([one.mean for one in found])
    value = _root(grid, isotonic_means((rising * counts)[None], counts[None])[0])
    lowest, highest = float(grid[0]), float(grid[-1])
    # Where the basic car's margin has reached the car's and stays there, all that is known is what it rose from.
    if value == math.inf and (rising < 0.0).any():
        highest = float(grid[rising < 0.0][-1])
    if value == -math.inf and (rising > 0.0).any():
        lowest = float(grid[rising > 0.0][0])
    return EquivalentMultiplier(
        value,
        _inverted(grid, [one.ci95 for one in found], value),
        _inverted(grid, [one.ci95_trials for one in found], value),
        lowest,
        highest,
    )


def isotonic_means(sums: FloatArray, counts: FloatArray) -> FloatArray:
    """Return the isotonic regression of each row's means, weighted by counts, all rows at once.

    f_i = max over j ≤ i of min over k ≥ i of the mean over j … k (Barlow et al. 1972, section 1.2).

    Args:
        sums: sum of the values at each place, rows × columns.
        counts: the weights, in the same shape, positive.
    """
    columns = sums.shape[1]
    start = np.zeros((len(sums), 1))
    below = np.hstack([start, np.cumsum(sums, axis=1)])
    weight = np.hstack([start, np.cumsum(counts, axis=1)])
    fitted = np.full(sums.shape, -math.inf)
    for first in range(columns):
        means = (below[:, first + 1 :] - below[:, [first]]) / (weight[:, first + 1 :] - weight[:, [first]])
        least = np.minimum.accumulate(means[:, ::-1], axis=1)[:, ::-1]
        np.maximum(fitted[:, first:], least, out=fitted[:, first:])
    return fitted


def _root(grid: FloatArray, rising: FloatArray) -> float:
    """Return where a rising polyline passes 0, in the middle where it stays there; infinite where it does not.

    Where it ends at 0 on either side, what lies beyond might be as good: that is infinite as well.
    """
    if rising[-1] <= 0.0:
        return math.inf
    if rising[0] >= 0.0:
        return -math.inf
    left, right = int(np.flatnonzero(rising < 0.0)[-1]), int(np.flatnonzero(rising > 0.0)[0])
    if right > left + 1:  # it is 0 in between
        return float(0.5 * (grid[left + 1] + grid[right - 1]))
    return _crossing(grid, rising, left)


def _inverted(grid: FloatArray, intervals: Sequence[Interval | None], value: float) -> Interval | None:
    """Return the C whose interval of the difference holds 0, from the first to the last of them, and the value."""
    if any(one is None for one in intervals):
        return None
    ends = np.array(intervals, dtype=np.float64)  # of the difference, which falls with C
    below = np.flatnonzero(ends[:, 0] <= 0.0)
    above = np.flatnonzero(ends[:, 1] >= 0.0)
    low = math.inf if not below.size else -math.inf if below[0] == 0 else _crossing(grid, ends[:, 0], int(below[0]) - 1)
    high = -math.inf if not above.size else math.inf
    if above.size and above[-1] < grid.size - 1:
        high = _crossing(grid, ends[:, 1], int(above[-1]))
    return min(low, value), max(high, value)


def _crossing(grid: FloatArray, ends: FloatArray, left: int) -> float:
    """Return where the line from a point to the next passes 0."""
    share = ends[left] / (ends[left] - ends[left + 1])
    return float(grid[left] + share * (grid[left + 1] - grid[left]))
