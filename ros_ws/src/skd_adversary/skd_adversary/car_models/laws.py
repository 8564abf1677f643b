"""Laws by which a car may brake: families, which of them the logs show, how far its trigger varies, calibration.

A law brakes while a measure of nearness is at most a trigger and, in some families, the adversary is in a path.
Measures: the distance, or the time until the front is there at the speeds of now. Paths: where the adversary is, or
where it will be when the car passes. The law is followed at once or some ticks later. The trigger is the same always
(sharp), drawn anew in each episode (normal), or blurred from tick to tick (logistic).

Families are chosen by held-out likelihood, with AIC and BIC beside it. Whether the chosen one predicts ticks that it
has not seen is said by their probability integral transform.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import scipy
from skd_sim.world.state import BoolArray, FloatArray, IntArray, Pair

from skd_adversary.car_models.car_model_file import LONGEST_DELAY, FamilyRow
from skd_adversary.car_models.identifiability import LEVEL, IntervalEstimate, marginal_estimate, step_estimate
from skd_adversary.car_models.observations import Observations
from skd_adversary.car_models.speed_change import SpeedChange, densities, distributions, moving

MEASURES = ("distance", "time")
GATES = ("none", "position", "predicted")
SPREADS = ("sharp", "episode", "tick")
LARGEST_TRIGGER = {"distance": 60.0, "time": 8.0}
"""Triggers thought possible go from 0 to this, in m and s."""
LARGEST_GATE = 20.0  # m
_BACKGROUND = 1e-6  # share of ticks in which the car does anything at all


@dataclass(frozen=True)
class Family:
    """A braking law without its numbers.

    Attributes:
        measure: `distance` (front to the adversary's centre along the lane) or `time` (that over the closing speed).
        gate: `none`, `position` (the adversary's distance from the car's centre line now) or `predicted` (its
            least distance from it while the car passes, at the velocities of now).
        spread: `sharp`, `episode` or `tick`.
        delay: ticks between what the car sees and what it does.
    """

    measure: str = "distance"
    gate: str = "none"
    spread: str = "sharp"
    delay: int = 0

    @property
    def name(self) -> str:
        """A name for tables."""
        path = {"none": "", "position": " in the lane", "predicted": " on a collision course"}[self.gate]
        spread = {"sharp": "", "episode": ", differs per episode", "tick": ", blurred per tick"}[self.spread]
        late = f", {self.delay} tick{'s' * (self.delay > 1)} late" if self.delay else ""
        return f"{self.measure}{path}{spread}{late}"

    @property
    def parameters(self) -> int:
        """Number of parameters of the decision: trigger, lapse, and what the family adds."""
        return 2 + (self.gate != "none") + (self.spread != "sharp") + (self.delay > 0)


@dataclass(frozen=True)
class Law:
    """A family with its likeliest numbers.

    Attributes:
        family: the family of the law.
        trigger: m or s.
        gate: half-width of the path, m; infinite without one.
        spread: standard deviation (episode) or scale (tick) of the trigger, m or s; 0 where sharp.
        lapse: share of ticks that go against the law.
        log_likelihood: log-likelihood of all ticks to which it was fitted.
    """

    family: Family
    trigger: float
    gate: float
    spread: float
    lapse: float
    log_likelihood: float


@dataclass(frozen=True, eq=False)
class BrakingEvidence:
    """What each tick says for and against braking, and the numbers by which a law decides.

    Attributes:
        braking: likelihood of the change of speed if the car braked.
        free: likelihood of the change of speed if it did not.
        nearness: measure of the family; infinite where it cannot trigger.
        aside: distance at which the family's gate looks, m; 0 without a gate.
        episode: number of the episode, for each tick.
    """

    braking: FloatArray
    free: FloatArray
    nearness: FloatArray
    aside: FloatArray
    episode: FloatArray


def _delayed(column: FloatArray, data: Observations, delay: int) -> FloatArray:
    """Return a column as it was `delay` ticks ago in the same episode; infinity where that is before its start."""
    if delay == 0:
        return column
    shifted = np.full(column.shape, np.inf)
    shifted[delay:] = column[:-delay]
    same = np.zeros(column.shape, dtype=bool)
    same[delay:] = (data.episode[delay:] == data.episode[:-delay]) & (data.tick[delay:] - data.tick[:-delay] == delay)
    return np.where(same, shifted, np.inf)


def nearness(data: Observations, family: Family) -> FloatArray:
    """Return what the trigger is compared with, m or s; infinite where the car would not brake however near."""
    if family.measure == "distance":
        near = np.where(data.gap >= 0.0, data.gap, np.inf)
    else:
        closing = data.speed - data.receding
        ahead = (closing > 0.0) & (data.gap >= -data.car_length)
        near = np.where(ahead, np.maximum(data.gap, 0.0) / np.where(ahead, closing, 1.0), np.inf)
    return _delayed(near, data, family.delay)


def aside(data: Observations, family: Family) -> FloatArray:
    """Return the adversary's distance from the car's centre line that the gate looks at, m."""
    if family.gate == "none":
        return np.zeros(len(data))
    if family.gate == "position":
        return _delayed(np.abs(data.lateral), data, family.delay)
    closing = data.speed - data.receding
    coming = closing > 1e-9
    safe = np.where(coming, closing, 1.0)
    begin = data.lateral + data.sideways * np.maximum(data.gap, 0.0) / safe
    end = data.lateral + data.sideways * np.maximum(data.gap + data.car_length, 0.0) / safe
    least = np.where(begin * end <= 0.0, 0.0, np.minimum(np.abs(begin), np.abs(end)))
    return _delayed(np.where(coming, least, np.inf), data, family.delay)


def evidence(change: SpeedChange, data: Observations, family: Family, rows: BoolArray) -> BrakingEvidence:
    """Return the evidence of the chosen rows; delays look back over all of `data`."""
    free, brake, background = (part[rows] for part in densities(change, data))
    share = _BACKGROUND * background
    near, beside = nearness(data, family)[rows], aside(data, family)[rows]
    return BrakingEvidence(brake + share, free + share, near, beside, data.episode[rows].astype(np.float64))


def _gains(e: BrakingEvidence, lapse: float) -> tuple[FloatArray, FloatArray]:
    """Return each tick's log-likelihood if the law drives freely, and how much it gains if the law brakes."""
    free = np.log((1.0 - lapse) * e.free + lapse * e.braking)
    return free, np.log((1.0 - lapse) * e.braking + lapse * e.free) - free


def _profile(position: FloatArray, gain: FloatArray, largest: float) -> tuple[FloatArray, FloatArray]:
    """Return (edges, values): the gain as a step function of a boundary, all positions at or below it counting."""
    inside = position <= largest
    order = np.argsort(position[inside], kind="stable")
    edges = np.concatenate([[0.0], position[inside][order], [largest]])
    return edges, np.append(0.0, np.cumsum(gain[inside][order]))


def trigger_profile(e: BrakingEvidence, law: Law) -> tuple[FloatArray, FloatArray]:
    """Return (edges, values) of the log-likelihood, up to a constant, as a function of a sharp trigger."""
    chosen = e.aside <= law.gate
    return _profile(e.nearness[chosen], _gains(e, law.lapse)[1][chosen], LARGEST_TRIGGER[law.family.measure])


def gate_profile(e: BrakingEvidence, law: Law) -> tuple[FloatArray, FloatArray]:
    """Return (edges, values) of the log-likelihood, up to a constant, as a function of the path's half-width."""
    chosen = e.nearness <= law.trigger
    return _profile(e.aside[chosen], _gains(e, law.lapse)[1][chosen], LARGEST_GATE)


def _sharp(family: Family, e: BrakingEvidence, lapse: float, gate: float) -> Law:
    """Return the likeliest sharp law, trigger and gate in turn."""
    law = Law(family, 0.0, gate, 0.0, lapse, -np.inf)
    free, gain = _gains(e, lapse)
    for _ in range(8):
        before = law.log_likelihood
        law = replace(law, trigger=step_estimate(*trigger_profile(e, law)).value)
        if family.gate != "none":
            law = replace(law, gate=step_estimate(*gate_profile(e, law)).value)
        chosen = (e.nearness <= law.trigger) & (e.aside <= law.gate)
        law = replace(law, log_likelihood=float(free.sum() + gain[chosen].sum()))
        if law.log_likelihood <= before + 1e-9:
            break
    return law


def _fit_sharp(family: Family, e: BrakingEvidence, near: Law | None = None) -> Law:
    if family.gate == "none":
        starts = [np.inf]
    elif near is not None:
        starts = [near.gate]
    else:
        finite = e.aside[np.isfinite(e.aside)]
        quantiles = np.quantile(finite, np.linspace(0.2, 1.0, 5)) if finite.size else np.array([LARGEST_GATE])
        starts = [float(value) for value in np.unique(quantiles)]
    lapse = 0.02
    best = max((_sharp(family, e, lapse, start) for start in starts), key=lambda law: law.log_likelihood)
    for _ in range(3):
        said = (e.nearness <= best.trigger) & (e.aside <= best.gate)
        against = np.where(said, e.free, e.braking)
        with_it = np.where(said, e.braking, e.free)
        share = best.lapse * against / (best.lapse * against + (1.0 - best.lapse) * with_it)
        lapse = float((share.sum() + 0.5) / (share.size + 1.0))  # never 0: what was not seen is not impossible
        best = _sharp(family, e, lapse, best.gate)
    return best


class _Segments(NamedTuple):
    """Segments of the trigger, over all episodes: edges, log-likelihoods, and the index of each episode's first."""

    lower: FloatArray
    upper: FloatArray
    values: FloatArray
    starts: IntArray


def _segments(e: BrakingEvidence, law: Law) -> _Segments:
    """Return the log-likelihood of each episode as a step function of its own trigger."""
    free, gain = _gains(e, law.lapse)
    gain = np.where(e.aside <= law.gate, gain, 0.0)
    near = np.where(e.aside <= law.gate, e.nearness, np.inf)
    names, first = np.unique(e.episode, return_index=True)
    base = np.add.reduceat(free, first)
    # A row for "no tick triggers" at the head of each episode.
    episode = np.concatenate([names, e.episode])
    position = np.concatenate([np.full(names.size, -np.inf), near])
    value = np.concatenate([base, gain])
    order = np.lexsort((position, episode))
    episode, position, value = episode[order], position[order], value[order]
    starts = np.flatnonzero(np.append(True, episode[1:] != episode[:-1]))
    running = np.cumsum(value)
    offset = np.append(0.0, running[starts[1:] - 1])
    values = running - np.repeat(offset, np.diff(np.append(starts, episode.size)))
    upper = np.append(position[1:], np.inf)
    upper[np.append(starts[1:] - 1, episode.size - 1)] = np.inf
    return _Segments(np.asarray(position), np.asarray(upper), np.asarray(values), np.asarray(starts))


def _spread_likelihoods(segments: _Segments, trigger: float, spread: float) -> FloatArray:
    """Return the log-likelihood of each episode when its trigger is N(trigger, spread²)."""
    lower, upper, values, starts = segments
    a, b = (lower - trigger) / spread, (upper - trigger) / spread
    flip = a > 0.0  # the tail on the near side keeps its digits
    with np.errstate(invalid="ignore", divide="ignore"):
        below, above = np.where(flip, -b, a), np.where(flip, -a, b)
        terms = values + np.log(scipy.special.ndtr(above) - scipy.special.ndtr(below))
    tops = np.maximum.reduceat(terms, starts)
    counts = np.diff(np.append(starts, terms.size))
    return np.asarray(tops + np.log(np.add.reduceat(np.exp(terms - np.repeat(tops, counts)), starts)))


def _tick_values(e: BrakingEvidence, law: Law) -> FloatArray:
    """Return the log-likelihood of each tick when the trigger is blurred by a logistic distribution."""
    inside = (e.aside <= law.gate) & np.isfinite(e.nearness)
    near = np.where(inside, e.nearness, 0.0)
    brakes = np.where(inside, scipy.special.expit((law.trigger - near) / law.spread), 0.0)
    brakes = law.lapse + (1.0 - 2.0 * law.lapse) * brakes
    return np.asarray(np.log(brakes * e.braking + (1.0 - brakes) * e.free))


def episode_values(e: BrakingEvidence, law: Law) -> FloatArray:
    """Return the log-likelihood of each episode under a law."""
    if law.family.spread == "episode":
        return _spread_likelihoods(_segments(e, law), law.trigger, law.spread)
    if law.family.spread == "tick":
        ticks = _tick_values(e, law)
    else:
        free, gain = _gains(e, law.lapse)
        ticks = free + np.where((e.nearness <= law.trigger) & (e.aside <= law.gate), gain, 0.0)
    _, first = np.unique(e.episode, return_index=True)
    return np.asarray(np.add.reduceat(ticks, first))


def spread_likelihoods(e: BrakingEvidence, law: Law, spreads: FloatArray) -> FloatArray:
    """Return, per spread, the log-likelihood of all ticks when each episode draws N(law's trigger, spread²)."""
    segments = _segments(e, law)
    return np.array([_spread_likelihoods(segments, law.trigger, float(spread)).sum() for spread in spreads])


def spread_values(e: BrakingEvidence, law: Law, triggers: FloatArray, spreads: FloatArray) -> FloatArray:
    """Return the log-likelihood of all ticks over a grid, triggers × spreads, under a law that is not sharp."""
    if law.family.spread == "episode":
        return np.stack([spread_likelihoods(e, replace(law, trigger=float(trigger)), spreads) for trigger in triggers])
    return np.array([[_tick_values(e, replace(law, trigger=t, spread=s)).sum() for s in spreads] for t in triggers])


def fit_family(family: Family, e: BrakingEvidence, sharp: Law | None = None, near: Law | None = None) -> Law:
    """Return the likeliest law of a family.

    Args:
        family: the family.
        e: the evidence, made for this family.
        sharp: the sharp law of the same measure, gate and delay, where it is known already.
        near: a law, fitted to other ticks, near which to look for this one; by default it is looked for everywhere.
    """
    law = sharp or _fit_sharp(replace(family, spread="sharp"), e, near)
    if family.spread == "sharp":
        return law
    law = replace(law, family=family, lapse=min(law.lapse, 1.0 / (len(e.free) + 1.0)))
    segments = _segments(e, law)

    def value(trigger: float, spread: float) -> float:
        if family.spread == "episode":
            return float(_spread_likelihoods(segments, trigger, spread).sum())
        return float(_tick_values(e, replace(law, trigger=trigger, spread=spread)).sum())

    def cost(point: FloatArray) -> float:
        inside = 0.0 <= point[0] <= LARGEST_TRIGGER[family.measure] and -12.0 <= point[1] <= 4.0
        return -value(float(point[0]), float(np.exp(point[1]))) if inside else np.inf

    scale = max(law.trigger, 0.1)
    found: list[Any] = []
    for share in (0.01, 0.15) if near is None else (near.spread / scale,):
        share = max(share, 1e-4)
        start = np.array([law.trigger, np.log(share * scale)])
        simplex = start + np.array([[0.0, 0.0], [share * scale, 0.0], [0.0, 1.0]])
        options: Any = {"xatol": 1e-3 * scale, "fatol": 1e-2, "maxiter": 70, "initial_simplex": simplex}
        found.append(scipy.optimize.minimize(cost, start, method="Nelder-Mead", options=options))
    best = min(found, key=lambda one: one.fun)
    return replace(law, trigger=float(best.x[0]), spread=float(np.exp(best.x[1])), log_likelihood=-float(best.fun))


DELAYS = range(LONGEST_DELAY + 1)
"""Ticks."""
SELECTION_FOLDS = 3
_HOPELESS = 100.0  # of AIC behind the best: a family of which no held-out likelihood is needed
_NEAR = 2.0  # nats of held-out likelihood that do not tell two families apart


@dataclass(frozen=True, eq=False)
class LawCandidate:
    """A family's law on all logs, the evidence for it, and the held-out log-likelihood of each episode.

    A family far behind in AIC has none of the latter.
    """

    law: Law
    evidence: BrakingEvidence
    held_out: FloatArray | None

    @property
    def score(self) -> float:
        """Held-out log-likelihood, nats."""
        return -math.inf if self.held_out is None else float(self.held_out.sum())

    @property
    def aic(self) -> float:
        """Akaike's information criterion."""
        return 2.0 * self.law.family.parameters - 2.0 * self.law.log_likelihood

    @property
    def bic(self) -> float:
        """Bayesian information criterion, over ticks."""
        return self.law.family.parameters * math.log(len(self.evidence.free)) - 2.0 * self.law.log_likelihood

    @property
    def row(self) -> FamilyRow:
        """Its line in the comparison of families."""
        family, likelihood = self.law.family, self.law.log_likelihood
        held_out = None if self.held_out is None else self.score
        return FamilyRow(family.name, family.parameters, likelihood, self.aic, self.bic, held_out, self.law.trigger)


def part(e: BrakingEvidence, rows: BoolArray) -> BrakingEvidence:
    """Return the evidence of some ticks."""
    return BrakingEvidence(e.braking[rows], e.free[rows], e.nearness[rows], e.aside[rows], e.episode[rows])


def folds_of(episode: FloatArray | IntArray, folds: int) -> IntArray:
    """Return the fold of each tick; an episode is never split."""
    _, index = np.unique(episode, return_inverse=True)
    return np.asarray(index % folds, dtype=np.int64)


def _held_out(law: Law, e: BrakingEvidence) -> LawCandidate:
    """Return the candidate of a law: its family is fitted to the other folds and judged on each."""
    fold = folds_of(e.episode, SELECTION_FOLDS)
    first = np.unique(e.episode, return_index=True)[1]
    held_out = np.zeros(first.size)
    for index in range(SELECTION_FOLDS):
        test = fold == index
        if test.any() and not test.all():
            known = fit_family(law.family, part(e, ~test), near=law)
            held_out[fold[first] == index] = episode_values(part(e, test), known)
    return LawCandidate(law, e, held_out)


def compare(change: SpeedChange, data: Observations, rows: BoolArray) -> list[LawCandidate]:
    """Return every family, fitted: all sharp ones, and with a spread the one chosen of them.

    Args:
        change: how the speed changes.
        data: all ticks, so that delays can look back.
        rows: the ticks that count.
    """
    found: list[LawCandidate] = []
    for measure, gate, delay in itertools.product(MEASURES, GATES, DELAYS):
        family = Family(measure, gate, "sharp", delay)
        e = evidence(change, data, family, rows)
        found.append(LawCandidate(fit_family(family, e), e, None))
    limit = min(candidate.aic for candidate in found) + _HOPELESS
    found = [_held_out(one.law, one.evidence) if one.aic <= limit else one for one in found]
    best = choose(found)
    for spread in SPREADS[1:]:
        blurred = fit_family(replace(best.law.family, spread=spread), best.evidence, best.law)
        found.append(_held_out(blurred, best.evidence))
    return sorted(found, key=lambda candidate: (-candidate.score, candidate.aic))


def choose(candidates: Sequence[LawCandidate]) -> LawCandidate:
    """Return the simplest candidate that held-out likelihood does not tell from the best.

    That is one within a standard error of the difference, episode by episode, or within two nats. Of equally simple
    ones the likelier is taken, and a distance rather than a time where they are alike.
    """
    resolved = [candidate for candidate in candidates if _resolved(candidate)]
    best = max(resolved, key=lambda candidate: candidate.score)
    alike = []
    for candidate in resolved:
        if best.held_out is not None and candidate.held_out is not None:
            difference = best.held_out - candidate.held_out
            error = math.sqrt(difference.size) * float(difference.std())
            if float(difference.sum()) <= max(_NEAR, error):
                alike.append(candidate)
    return min(alike, key=lambda c: (c.law.family.parameters, -round(c.score, 6), c.law.family.measure))


def _resolved(candidate: LawCandidate) -> bool:
    """Whether a spread is more than the uncertainty that the logs would leave about a sharp trigger."""
    law = candidate.law
    if law.family.spread == "sharp":
        return True
    sharp = fit_family(replace(law.family, spread="sharp"), candidate.evidence)
    return law.spread > 2.0 * step_estimate(*trigger_profile(candidate.evidence, sharp)).standard_error


_SPREAD_POINTS = 31


def sharp_spread(e: BrakingEvidence, law: Law) -> IntervalEstimate:
    """Return the spread of a trigger that was found sharp: 0, and how large a spread the logs could have hidden.

    The upper end is the 95 % point of its posterior under a flat prior, the trigger at its estimate.
    """
    spreads = max(law.trigger, 1e-3) * np.geomspace(1e-4, 1.0, 40)
    values = spread_likelihoods(e, law, spreads)
    density = np.exp(values - values.max())
    weights = np.append(density[0] * spreads[0], 0.5 * (density[1:] + density[:-1]) * np.diff(spreads))
    cumulative = np.cumsum(weights) / weights.sum()
    high = float(np.interp(LEVEL, cumulative, spreads))
    return IntervalEstimate(0.0, high / 2.0, 0.0, high)


def spread_estimates(e: BrakingEvidence, law: Law) -> tuple[IntervalEstimate, IntervalEstimate]:
    """Return trigger and spread of a law whose trigger is not sharp, from their posterior on a grid, flat priors."""
    step = 0.1 * max(law.spread, 1e-3)
    triggers: FloatArray = np.empty(0)
    spreads: FloatArray = np.empty(0)
    low, high = law.trigger - 10.0 * step, law.trigger + 10.0 * step
    least, most = 0.3 * law.spread, 2.5 * law.spread
    by_trigger = by_spread = triggers
    for _ in range(4):
        triggers, spreads = np.linspace(max(0.0, low), high, _SPREAD_POINTS), np.linspace(least, most, _SPREAD_POINTS)
        values = spread_values(e, law, triggers, spreads)
        density = np.exp(values - values.max())
        by_trigger, by_spread = density.sum(axis=1), density.sum(axis=0)
        inside = by_trigger > 1e-4 * by_trigger.max()
        within = by_spread > 1e-4 * by_spread.max()
        if not (inside[0] or inside[-1] or within[-1]) and inside.sum() > 8 and within.sum() > 8:
            break
        low, high = _around(triggers, inside)
        least, most = _around(spreads, within)
        least = max(1e-4 * max(law.trigger, 1e-3), least)
    trigger = marginal_estimate(triggers, by_trigger, law.trigger)
    return trigger, marginal_estimate(spreads, by_spread, law.spread)


def _around(grid: FloatArray, inside: FloatArray) -> Pair:
    """Return a range around the points that count, wider where they reach the grid's ends."""
    chosen = np.flatnonzero(inside)
    step = float(grid[1] - grid[0])
    low = grid[chosen[0]] - (10.0 if chosen[0] == 0 else 1.0) * step
    high = grid[chosen[-1]] + (10.0 if chosen[-1] == grid.size - 1 else 1.0) * step
    return float(low), float(high)


def braking_probability(law: Law, data: Observations) -> FloatArray:
    """Return the probability that the car brakes, per tick, each taken by itself."""
    near, inside = nearness(data, law.family), aside(data, law.family) <= law.gate
    inside &= np.isfinite(near)
    distance = law.trigger - np.where(inside, near, 0.0)
    if law.family.spread == "sharp" or law.spread <= 0.0:
        brakes = (distance >= 0.0).astype(np.float64)
    elif law.family.spread == "episode":
        brakes = scipy.special.ndtr(distance / law.spread)
    else:
        brakes = scipy.special.expit(distance / law.spread)
    brakes = np.where(inside, brakes, 0.0)
    return np.asarray(law.lapse + (1.0 - 2.0 * law.lapse) * brakes)


def integral_transform(change: SpeedChange, law: Law, data: Observations, rng: np.random.Generator) -> FloatArray:
    """Return the predicted distribution function at each recorded change of speed: uniform, if the model is right.

    Where the car came to stand, which has a probability of its own, a uniform draw below it is taken.
    """
    rows: BoolArray = moving(data)
    free, braking = distributions(change, data)
    brakes = braking_probability(law, data)
    value = (brakes * braking + (1.0 - brakes) * free)[rows]
    stopped = data.speed_after[rows] <= 0.0
    return np.asarray(np.where(stopped, value * rng.random(value.size), value))


def kolmogorov_smirnov(values: FloatArray) -> Pair:
    """Return statistic and p-value of uniformity on [0, 1] (asymptotic, with Stephens' correction)."""
    n = values.size
    ordered = np.sort(values)
    steps = np.arange(1, n + 1) / n
    statistic = float(max((steps - ordered).max(), (ordered - steps + 1.0 / n).max()))
    root = np.sqrt(n)
    return statistic, float(scipy.special.kolmogorov((root + 0.12 + 0.11 / root) * statistic))
