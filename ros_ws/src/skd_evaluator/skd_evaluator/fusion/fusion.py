"""What the physical car does, from physical trials and a simulator: every figure with its interval, test and gap."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from skd_sim.errors import UsageError

from skd_evaluator.fusion.control_variate import (
    LEAST_PAIRS,
    Line,
    Mean,
    alone,
    checked_pairs,
    fitted_line,
    fused,
    skewness,
    stand_for_all,
    trials_saved,
)
from skd_evaluator.fusion.figures import FIGURES, Figure
from skd_evaluator.fusion.gap import Gap, gap_of
from skd_evaluator.fusion.pairs import GAP_TOLERANCE, Pairs, paired
from skd_evaluator.fusion.rate import LEAST_OF_EACH, alone_rate, enough_of_each, fused_rate
from skd_evaluator.fusion.trial import Trial
from skd_evaluator.measure.statistics.sequential import nominal_confidence

_MANY = 5
"""Simulated φ for each physical one, below which their own error is felt."""
_RARE = 9.0
"""Kurtosis of what is simulated from which a few φ decide a mean; the normal distribution has 3."""
_FEW, _SKEWED = 20, 1.5
"""φ with trials and skewness, below and above which intervals hold less often than they say (docs/fusion.md)."""


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

    figure: Figure
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
                **self.gap.as_dict(),
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
    physical: Sequence[Trial],
    simulated: Mapping[str, Sequence[Trial]],
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
            looks together, and so whenever one stops (`measure.statistics.sequential`).
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
        raise UsageError(
            left_out[0]
            if left_out
            else f"physical and simulated trials have no figure in common; known are {', '.join(FIGURES)}"
        )
    return Fusion(tuple(found), tuple(left_out))


def fused_figure(figure: Figure, pairs: Pairs, confidence: float) -> FusedFigure:
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
    try:
        y, x, _ = checked_pairs(pairs.physical, pairs.simulated, pairs.population)
        line = fitted_line(y, x)
        if line.predicts and not figure.is_rate and not stand_for_all(x, pairs.population):
            raise NotSaidError(
                f"{figure.text}: nothing is said, for the φ with trials are too alike: in the simulation, which "
                f"predicts it, its standard deviation is {np.std(x, ddof=1):.3g} {figure.unit} over them and "
                f"{np.std(pairs.population, ddof=1):.3g} over all φ; a few other φ decide the mean: make more trials"
            )
        by_itself = alone_rate(pairs.groups, confidence) if figure.is_rate else alone(y, confidence)
        both, why = _with_simulator(figure, pairs, line, confidence)
    except NotSaidError:
        raise
    except ValueError as error:
        raise UsageError(f"{figure.text}: {error}") from error
    if not why and not line.predicts:
        why = "the simulator does not predict this figure"
    saved = 0
    if both is not None and not why:
        if figure.is_rate:
            saved = max(0, int(y.size * (by_itself.width / both.width) ** 2) - y.size)
        else:
            saved = trials_saved(y.size, both.width / by_itself.width, confidence)
    gap = gap_of(y, x, pairs.trials, pairs.predicted, confidence)
    return FusedFigure(
        figure,
        pairs,
        confidence,
        by_itself,
        both,
        line,
        gap,
        saved,
        why,
        tuple(_notes(pairs, line, why, is_rate=figure.is_rate)),
    )


def _with_simulator(figure: Figure, pairs: Pairs, line: Line, confidence: float) -> tuple[Mean | None, str]:
    """Return the figure by both, or why there is none."""
    y, x, population = pairs.physical, pairs.simulated, pairs.population
    if line.slope is None:
        return None, "the simulator says the same of all these φ"
    if figure.is_rate:
        if not enough_of_each(pairs.groups):
            return None, (f"there are fewer than {LEAST_OF_EACH} trials with a hit, or without one")
        return fused_rate(y, x, population, line, confidence), ""
    return fused(y, x, population, line, confidence), ""


def _notes(pairs: Pairs, line: Line, why_alone: str, *, is_rate: bool) -> list[str]:
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
    centre = pairs.physical - pairs.physical.mean()
    left = centre if why_alone else centre - (line.slope or 0.0) * (pairs.simulated - pairs.simulated.mean())
    if not is_rate and len(left) < _FEW and abs(skewness(left)) > _SKEWED:
        found.append("few and very skewed figures: intervals of such hold 90 to 94 % of the time, not 95 %")
    off = pairs.population - pairs.population.mean()
    if not is_rate and float(np.mean(off**4)) > _RARE * float(np.mean(off**2)) ** 2:
        found.append("a few φ decide the mean, by the simulation: intervals of such hold 80 to 95 % of the time")
    if (np.array([len(group) for group in pairs.groups]) > 1).any():
        found.append("several trials of a φ count as one: the interval is by φ")
    return found
