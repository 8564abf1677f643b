"""Which family of braking laws: held-out likelihood, with AIC and BIC beside it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from skd_sim.arrays import BoolArray, FloatArray, IntArray

from skd_adversary.car_models.families import (
    GATES,
    MEASURES,
    SPREADS,
    Evidence,
    Family,
    Law,
    episode_values,
    evidence,
    fit_family,
    sharp_estimate,
)
from skd_adversary.car_models.fitted_car import LONGEST_DELAY
from skd_adversary.car_models.observations import Observations
from skd_adversary.car_models.speed_change import SpeedChange

DELAYS = range(LONGEST_DELAY + 1)
"""Ticks."""
FOLDS = 3
_HOPELESS = 100.0  # of AIC behind the best: a family that held-out likelihood need not be asked about
_NEAR = 2.0  # nats of held-out likelihood that do not tell two families apart


@dataclass(frozen=True, eq=False)
class Candidate:
    """A family's law on all logs, the evidence for it, and the held-out log-likelihood of each episode.

    A family far behind in AIC has none of the latter.
    """

    law: Law
    evidence: Evidence
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


def part(e: Evidence, rows: BoolArray) -> Evidence:
    """Return the evidence of some ticks."""
    return Evidence(e.braking[rows], e.free[rows], e.nearness[rows], e.aside[rows], e.episode[rows])


def folds_of(episode: FloatArray | IntArray, folds: int) -> IntArray:
    """Return the fold of each tick; an episode is never split."""
    _, index = np.unique(episode, return_inverse=True)
    return np.asarray(index % folds, dtype=np.int64)


def _held_out(law: Law, e: Evidence) -> Candidate:
    """Return the candidate of a law: its family is fitted to the other folds and judged on each."""
    fold = folds_of(e.episode, FOLDS)
    _, first = np.unique(e.episode, return_index=True)
    held_out = np.zeros(first.size)
    for index in range(FOLDS):
        test = fold == index
        if test.any() and not test.all():
            known = fit_family(law.family, part(e, ~test), near=law)
            held_out[fold[first] == index] = episode_values(part(e, test), known)
    return Candidate(law, e, held_out)


def compare(change: SpeedChange, data: Observations, rows: BoolArray) -> list[Candidate]:
    """Return every family, fitted: all sharp ones, and with a spread the one chosen of them.

    Args:
        change: how the speed changes.
        data: all ticks, so that delays can look back.
        rows: the ticks that count.
    """
    found: list[Candidate] = []
    for measure in MEASURES:
        for gate in GATES:
            for delay in DELAYS:
                family = Family(measure, gate, "sharp", delay)
                e = evidence(change, data, family, rows)
                found.append(Candidate(fit_family(family, e), e, None))
    limit = min(candidate.aic for candidate in found) + _HOPELESS
    found = [_held_out(one.law, one.evidence) if one.aic <= limit else one for one in found]
    best = choose(found)
    for spread in SPREADS[1:]:
        blurred = fit_family(replace(best.law.family, spread=spread), best.evidence, best.law)
        found.append(_held_out(blurred, best.evidence))
    return sorted(found, key=lambda candidate: (-candidate.score, candidate.aic))


def choose(candidates: Sequence[Candidate]) -> Candidate:
    """Return the simplest candidate that held-out likelihood does not tell from the best.

    That is one within a standard error of the difference, episode by episode, or within two nats. Of equally simple
    ones the likelier is taken, and a distance rather than a time where they are alike.
    """
    resolved = [candidate for candidate in candidates if _resolved(candidate)]
    best = max(resolved, key=lambda candidate: candidate.score)
    alike = []
    for candidate in resolved:
        if best.held_out is None or candidate.held_out is None:
            continue
        difference = best.held_out - candidate.held_out
        error = math.sqrt(difference.size) * float(difference.std())
        if float(difference.sum()) <= max(_NEAR, error):
            alike.append(candidate)
    return min(alike, key=lambda c: (c.law.family.parameters, -round(c.score, 6), c.law.family.measure))


def _resolved(candidate: Candidate) -> bool:
    """Whether a spread is more than the uncertainty that the logs would leave about a sharp trigger."""
    law = candidate.law
    if law.family.spread == "sharp":
        return True
    sharp = fit_family(replace(law.family, spread="sharp"), candidate.evidence)
    return law.spread > 2.0 * sharp_estimate(candidate.evidence, sharp).standard_error
