"""What the physical car does, from physical trials and a simulator: every figure with its interval, test and gap."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy import stats
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError

from skd_evaluator.extensions.fusion.estimate import (
    LEAST_OF_EACH,
    LEAST_PAIRS,
    Line,
    Mean,
    Reach,
    alone,
    alone_rate,
    enough_of_each,
    fitted_line,
    fused,
    fused_rate,
    kurtosis,
    least_variance,
    rehearsed,
    skewness,
    stand_for_all,
    trials_saved,
)
from skd_evaluator.extensions.fusion.trials import FIGURES, GAP_TOLERANCE, Pairs, PhysicalTrial, TrialFigure, paired
from skd_evaluator.metrics.clustered import student_quantile
from skd_evaluator.metrics.sample_size import nominal_confidence
from skd_evaluator.metrics.statistics import Interval


@dataclass(frozen=True)
class GapTrend:
    """How a gap changes with something.

    Attributes:
        slope: of the line of least squares, in the unit of the gap per unit of what it is held against.
        interval: of the slope, by Student's t.
        p_value: two-sided, of no trend.
    """

    slope: float
    interval: Interval
    p_value: float


@dataclass(frozen=True, eq=False)
class Gap:
    """Physical less simulated figure.

    Attributes:
        by_phi: of each φ, in the order of the pairs.
        mean: over these φ.
        interval: of the mean, by Student's t; None where all gaps are the same.
        by_simulated: whether it grows with the simulated figure: 0 where the simulator is off by the same everywhere.
        by_order: whether it grows from trial to trial, per trial: brakes that warm up, a track that dries.
    """

    by_phi: FloatArray
    mean: float
    interval: Interval | None
    by_simulated: GapTrend | None
    by_order: GapTrend | None


def gap_of(y: FloatArray, x: FloatArray, trials: FloatArray, predicted: FloatArray, confidence: float = 0.95) -> Gap:
    """Return the gap of pairs.

    Args:
        y: physical figures, one of each φ.
        x: simulated figures of the same φ.
        trials: physical figures of each trial, in the order in which they were made.
        predicted: what the simulator says of each of these trials.
        confidence: of the intervals, two-sided.
    """
    gaps = y - x
    centre, deviation = float(gaps.mean()), float(gaps.std(ddof=1))
    half = student_quantile(gaps.size - 1.0, confidence) * deviation / math.sqrt(gaps.size)
    interval = (centre - half, centre + half) if half > 0.0 else None
    order = trend(np.arange(trials.size, dtype=np.float64), trials - predicted, confidence)
    return Gap(gaps, centre, interval, trend(x, gaps, confidence), order)


def trend(places: FloatArray, values: FloatArray, confidence: float = 0.95) -> GapTrend | None:
    """Return the line of least squares of values over places; None where the places or the values are all the same."""
    if places.size < 3 or not np.ptp(places) or not np.ptp(values) > 1e-9 * float(np.abs(values).max()):
        return None
    line = stats.linregress(places, values)
    half = student_quantile(places.size - 2.0, confidence) * float(line.stderr)
    slope = float(line.slope)
    return GapTrend(slope, (slope - half, slope + half), float(line.pvalue))


_MANY = 5
"""Simulated φ for each physical one, below which their own error is felt."""
_RARE, _FEW = 12.0, 20
"""Kurtosis of what is simulated from which a few φ decide a mean, and the φ with trials that it then takes to say
something. The normal distribution has 3."""
_MOST_REACH, _FELT = 4.0, 1.25
"""How many times as far as Student's an interval may reach before nothing is said; and before that is said."""


class NotSaidError(UsageError):
    """A figure of which nothing can be said by these trials; the message says why."""


@dataclass(frozen=True, eq=False)
class FusedFigure:
    """One figure of the physical car.

    Attributes:
        figure: which.
        pairs: that it rests on.
        confidence: of each interval.
        alone: by the physical trials alone.
        with_simulator: by both; None where it cannot be said.
        line: through the pairs.
        gap: physical less simulated.
        saved: further physical φ that an interval as narrow would have taken without the simulator.
        why_alone: why the physical trials stand alone; empty where they do not.
        notes: what a reader should know, a sentence each.
    """

    figure: TrialFigure
    pairs: Pairs
    confidence: float
    alone: Mean
    with_simulator: Mean | None
    line: Line
    gap: Gap
    saved: int
    why_alone: str
    notes: tuple[str, ...]

    @property
    def predicts(self) -> bool:
        """Whether the simulator predicts this figure, so that both together stand."""
        return not self.why_alone

    @property
    def stands(self) -> Mean:
        """What is said: with the simulator where it predicts, else by the physical trials alone."""
        return self.alone if self.with_simulator is None or self.why_alone else self.with_simulator

    def as_dict(self) -> dict[str, Any]:
        """Return the entry of fusion.json."""
        names, pairs = self.pairs.names, self.pairs
        return {
            "unit": self.figure.unit,
            "value": self.stands.value,
            "interval": self.stands.interval,
            "confidence": self.confidence,
            "predicts": self.predicts,
            "why_alone": self.why_alone or None,
            "p_value": self.line.p_value,
            "correlation": self.line.correlation,
            "slope": self.line.slope,
            "residual_deviation": self.line.residual**0.5,
            "deviation": self.alone.error * len(names) ** 0.5,
            "physical_alone": asdict(self.alone),
            "with_simulator": self.with_simulator and asdict(self.with_simulator),
            "phi": len(names),
            "trials": pairs.trials.size,
            "simulated_phi": pairs.population.size,
            "simulated_mean": float(pairs.population.mean()),
            "trials_saved": self.saved,
            "gap": {
                "mean": self.gap.mean,
                "interval": self.gap.interval,
                "by_simulated": self.gap.by_simulated and asdict(self.gap.by_simulated),
                "by_order": self.gap.by_order and asdict(self.gap.by_order),
                "by_phi": [
                    {"phi": name, "trials": group.size, "physical": real, "simulated": said, "gap": real - said}
                    for name, group, real, said in zip(
                        names, pairs.groups, pairs.physical.tolist(), pairs.simulated.tolist(), strict=True
                    )
                ],
            },
            "notes": list(self.notes),
        }


@dataclass(frozen=True, eq=False)
class Fusion:
    """All figures of the physical car.

    Attributes:
        figures: those that can be said.
        left_out: why others are not, a line each.
    """

    figures: tuple[FusedFigure, ...]
    left_out: tuple[str, ...]


def fuse(
    physical: Sequence[PhysicalTrial],
    simulated: Mapping[str, Sequence[PhysicalTrial]],
    *,
    looks: int = 1,
    confidence: float = 0.95,
    tolerance: float = GAP_TOLERANCE,
) -> Fusion:
    """Return every figure that both kinds of trials have.

    Args:
        physical: trials, in the order in which they were made.
        simulated: trials by φ.
        looks: how often one looks, at most, before one stops: after equal numbers of trials. Intervals then hold at all
            looks together, and so whenever one stops (`metrics.statistics.sequential`).
        confidence: of all looks together.
        tolerance: of the timing of pairs, m.

    Raises:
        UsageError: no figure in common, too few trials, pairs that do not match, or figures that cannot be of trials.
    """
    share = nominal_confidence(looks, confidence) if looks > 1 else confidence
    found, left_out = [], []
    for figure in FIGURES.values():
        pairs = paired(figure, physical, simulated, tolerance)
        if pairs is None:
            continue
        if not figure.is_rate and len(set(pairs.physical.tolist())) == 1:
            left_out.append(
                f"{figure.text}: {pairs.physical[0]:.6g} {figure.unit} on every φ with trials, so nothing is known of "
                "how it varies, and nothing is said of other φ"
            )
            continue
        try:
            found.append(fused_figure(figure, pairs, share))
        except NotSaidError as error:
            left_out.append(str(error))
    if not found:
        none = f"physical and simulated trials have no figure in common; known are {', '.join(FIGURES)}"
        raise UsageError(left_out[0] if left_out else none)
    return Fusion(tuple(found), tuple(left_out))


def fused_figure(figure: TrialFigure, pairs: Pairs, confidence: float) -> FusedFigure:
    """Return a figure of the physical car by its pairs.

    Raises:
        NotSaidError: the φ with trials do not stand for all of them.
        UsageError: too few φ with trials, or figures that cannot be of trials.
    """
    if len(pairs.names) < LEAST_PAIRS:
        raise UsageError(
            f"{len(pairs.trials)} physical trials on {len(pairs.names)} φ: at least {LEAST_PAIRS} φ with trials are "
            "needed, for the interval speaks of all φ"
        )
    y, x, population = pairs.physical, pairs.simulated, pairs.population
    line, is_rate, why, both = fitted_line(y, x), figure.is_rate, "", None
    _check_spread(figure, pairs, line)
    if line.slope is None:
        why = "the simulator says the same of all these φ"
    elif is_rate and not enough_of_each(pairs.groups):
        why = f"there are fewer than {LEAST_OF_EACH} φ with a hit, or without one"
    try:
        if is_rate:
            by_itself = alone_rate(pairs.groups, confidence)
            both = None if why else fused_rate(y, x, population, line, confidence)
        else:
            by_itself = alone(y, confidence, _reach(figure, pairs, line, confidence, by_line=False))
            if not why:
                reach = _reach(figure, pairs, line, confidence, by_line=True)
                both = fused(y, x, population, line, confidence, wrong=figure.wrong, reach=reach)
    except NotSaidError:
        raise
    except ValueError as error:
        raise UsageError(f"{figure.text}: {error}") from error
    saved = 0
    if not why and not line.predicts:
        why = "the simulator does not predict this figure"
    elif both is not None and is_rate:
        saved = max(0, int(y.size * (by_itself.width / both.width) ** 2) - y.size)
    elif both is not None:
        saved = trials_saved(y.size, both.width / by_itself.width, confidence)
    gap = gap_of(y, x, pairs.trials, pairs.predicted, confidence)
    notes = tuple(_notes(figure, pairs, line, why, confidence))
    return FusedFigure(figure, pairs, confidence, by_itself, both, line, gap, saved, why, notes)


def _check_spread(figure: TrialFigure, pairs: Pairs, line: Line) -> None:
    """Refuse trials on φ that are too much alike, or of a figure that a few φ decide, none of which need be among them.

    Raises:
        NotSaidError: it is so.
    """
    begin, x, count = f"{figure.text}: nothing is said, for", pairs.simulated, len(pairs.names)
    if figure.is_rate:
        return
    if line.predicts and not stand_for_all(x, pairs.population):
        few, every = (f"{np.std(one, ddof=1):.3g} {figure.unit}" for one in (x, pairs.population))
        raise NotSaidError(
            f"{begin} the φ with trials are too alike (simulated standard deviation {few}, over all φ {every}): make "
            "more trials"
        )
    if count < _FEW and kurtosis(pairs.shape) > _RARE:
        raise NotSaidError(
            f"{begin} a few φ decide the mean (simulated kurtosis {kurtosis(pairs.shape):.0f}), and {count} φ need not "
            f"have any of them: make trials on at least {_FEW} φ"
        )


def _reach(figure: TrialFigure, pairs: Pairs, line: Line, confidence: float, *, by_line: bool) -> Reach:
    """Return how far an interval reaches for figures of the shape of the simulated ones.

    Raises:
        NotSaidError: too far, in the interval that would stand.
    """
    off = pairs.physical - pairs.physical.mean()
    if by_line:
        off = off - (line.slope or 0.0) * (pairs.simulated - pairs.simulated.mean())
    leans = skewness(pairs.shape - pairs.shape.mean()) >= 0.0
    mirrored, least = (skewness(off) >= 0.0) != leans, least_variance(off.size) if line.predicts else 0.0
    reach = rehearsed(pairs.shape, off.size, confidence, by_line=by_line, mirrored=mirrored, least=least)
    if line.predicts == by_line and reach.further > _MOST_REACH:
        raise NotSaidError(
            f"{figure.text}: nothing is said, for the simulated figures are so skewed over φ that {len(pairs.names)} "
            "trials do not tell the mean of such: make more trials"
        )
    return reach


def _notes(figure: TrialFigure, pairs: Pairs, line: Line, why_alone: str, confidence: float) -> list[str]:
    found = []
    if not pairs.timed:
        found.append("the timing of physical trials is not known: pairs are of the same φ alone")
    if why_alone:
        found.append(f"{why_alone}: the physical trials stand alone")
    elif pairs.population.size < _MANY * len(pairs.names):
        found.append(
            f"only {pairs.population.size} simulated φ for {len(pairs.names)} physical ones: more would narrow the "
            "interval"
        )
    if not figure.is_rate:
        reach = _reach(figure, pairs, line, confidence, by_line=not why_alone).further
        if reach > _FELT:
            found.append(
                f"the simulated figures are skewed over φ: the interval reaches up to {reach:.1f} times as far as that "
                "of normal figures"
            )
        if kurtosis(pairs.shape) > _RARE:
            found.append("a few φ decide the mean, by the simulation: more trials may move it much")
    if (np.array([len(group) for group in pairs.groups]) > 1).any():
        found.append("several trials of a φ count as one: the interval is by φ")
    return found
