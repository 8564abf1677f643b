"""The risk of a car: the probability that its front hits a road user who walks φ with natural variation, scaled by s.

A hit is a contact with the front of the car, its corners included, at `collision.hit_speed` or more of its own speed;
contacts with its flank or rear, and with a car that stands, are counted apart. φ are fixed: each is as likely as any
other. Crude: a share of runs. Where few of them are hits, subset simulation (`skd_evaluator.risk.subset`): the mean of
what its replicates estimate.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from typing import Any, Final

import numpy as np
from skd_sim.world.episode import EpisodeLog
from skd_sim.world.state import FloatArray, IntArray

from skd_evaluator.metrics.clustered import GroupedMean, GroupedRate, student_quantile
from skd_evaluator.metrics.entry import Entry, Share
from skd_evaluator.metrics.statistics import Interval, mean, wilson_interval

SCALES: Final = (1.0, 2.0, 3.0)
RANKS: Final = 2.0
"""Scale whose risk ranks cars, fixed before any were ranked (docs/validation.md)."""
FEW_HITS: Final = 50
"""Hits of crude runs below which subset simulation is asked."""
UNSEEN: Final = 1e-4
"""Below it a risk is a statement about the behaviour model: so few people identify no tail."""
CONDITIONAL: Final = "below 1e-4 conditional on the behaviour model, whose tails no data identify"
UNEVEN: Final = (
    "replicates differ by more than their mean: few of them decide it, and intervals of such hold less often"
)
"""See docs/metrics.md."""


class Touch(IntEnum):
    """What a run ended in."""

    NONE = 0
    FRONT = 1
    """A hit: with the front, its corners included."""
    FLANK = 2
    """With a side or the rear of a moving car."""
    STANDING = 3
    """With a car slower than the scenario's `collision.hit_speed`."""
    ABORTED = 4


@dataclass(frozen=True, eq=False)
class Subsets:
    """What subset simulation found at one scale.

    Attributes:
        shares: for each replicate the share of the hits of its last level that are on each φ, times its estimate:
            replicates × φ; a row sums to the replicate's estimate.
        levels: number of levels of each replicate, the first one included.
        per_level: crossings of a level.
        open_levels: number of replicates that came to no hit within the levels that they had.
    """

    shares: FloatArray
    levels: IntArray
    per_level: int
    open_levels: int = 0

    @property
    def estimates(self) -> FloatArray:
        """What each replicate estimates."""
        return np.array([math.fsum(row) for row in self.shares])

    @property
    def episodes(self) -> int:
        """Crossings in all, those included by which the levels were found.

        A tenth of each level but the first is taken over from the one before.
        """
        added = self.per_level - self.per_level // 10
        levels = [*self.levels.tolist(), int(self.levels.max())]
        return sum(self.per_level + (level - 1) * added for level in levels)


@dataclass(frozen=True, eq=False)
class ScaleRisk(Entry):
    """The risk at one scale.

    Attributes:
        scale: by which every normal of the behaviour is multiplied.
        touches: for each crude run how it ended (`Touch`); run k walks φ number k modulo the number of φ.
        phis: number of φ.
        subsets: what subset simulation found; None: it was not asked.
        confidence: of the intervals by φ.
        ticks: of each crude run, until its end or the contact; None: not known.
        lost: crossings of subset simulation that were aborted, with which it ended: then there is no risk at this
            scale. They are neither hits nor misses, and a car that ends just those that hit would have none.
    """

    KEYS = "scale value ci95 ci95_by_phi method episodes gain runs hits flank standing aborted subset_aborted note"

    scale: float
    touches: IntArray
    phis: int
    subsets: Subsets | None = None
    confidence: float = 0.95
    ticks: IntArray | None = None
    lost: int = 0

    @property
    def counts(self) -> list[tuple[int, int]]:
        """Hits and runs of each φ; aborted runs are none."""
        mine = [self.touches[index :: self.phis] for index in range(self.phis)]
        return [(int((one == Touch.FRONT).sum()), int((one != Touch.ABORTED).sum())) for one in mine]

    @property
    def groups(self) -> tuple[FloatArray, ...]:
        """Values of each φ whose mean over φ is the risk: of each run 1 for a hit, or what each replicate estimates."""
        if self.subsets is not None:
            return tuple(self.phis * column for column in self.subsets.shares.T)
        mine = [self.touches[index :: self.phis] for index in range(self.phis)]
        return tuple((one[one != Touch.ABORTED] == Touch.FRONT).astype(np.float64) for one in mine)

    def number_of(self, touch: Touch) -> int:
        """Return how many crude runs ended so."""
        return int((self.touches == touch).sum())

    @property
    def runs(self) -> int:
        """Crude runs that were not aborted."""
        return len(self.touches) - self.number_of(Touch.ABORTED)

    @property
    def hits(self) -> int:
        """Crude runs that the front of the moving car hit."""
        return self.number_of(Touch.FRONT)

    @property
    def episodes(self) -> int:
        """Crossings that were run, crude and of subset simulation."""
        return len(self.touches) + (0 if self.subsets is None else self.subsets.episodes)

    @cached_property
    def value(self) -> Share | None:
        """R(s); None without a run, or where subset simulation was asked and crossings of it were aborted."""
        if self.lost:
            return None
        if self.subsets is not None:
            return mean(self.subsets.estimates)
        return self.hits / self.runs if self.runs else None

    @cached_property
    def ci95(self) -> Interval | None:
        """95 % interval of the estimate, for these φ: Wilson's, the rule of three, or log-t over replicates."""
        if self.lost:
            return None
        if self.subsets is not None:
            if not self.value:  # no replicate came to a hit: it is less than what its levels tell
                return 0.0, 0.1 ** (int(self.subsets.levels.min()) - 1)
            return log_t_interval(self.subsets.estimates)
        if self.runs and not self.hits:
            return 0.0, min(1.0, 3.0 / self.runs)
        return wilson_interval(self.hits, self.runs)

    @cached_property
    def ci95_by_phi(self) -> Interval | None:
        """95 % interval over φ: for the mean of all φ that there might be; None below two φ."""
        if self.lost:
            return None
        if self.subsets is None:
            return GroupedRate(self.counts, self.confidence).interval
        return GroupedMean(self.groups, limits=(0.0, 1.0), confidence=self.confidence).interval

    @property
    def method(self) -> str:
        """How it was estimated, and from how much."""
        if self.lost:
            return f"none; subset simulation was ended (crude: {self.hits} of {self.runs} runs)"
        if self.subsets is None:
            rule = ", rule of three" if self.runs and not self.hits else ""
            return f"crude, {self.hits} of {self.runs} runs{rule}"
        found = self.subsets
        never = f", {found.open_levels} of them without a hit" if found.open_levels else ""
        crude = f"(crude: {self.hits} of {self.runs} runs)"
        return f"subset simulation, {len(found.levels)} replicates of {found.per_level} a level{never} {crude}"

    @property
    def gain(self) -> float | None:
        """How many times as many crude runs would have the error that the crossings of subset simulation bought."""
        if self.subsets is None or not self.value or len(self.subsets.levels) < 2:
            return None
        values = self.subsets.estimates
        variance = float(np.var(values, ddof=1)) / len(values)
        return None if variance <= 0.0 else self.value * (1.0 - self.value) / variance / self.subsets.episodes

    @property
    def flank(self) -> int:
        """Crude runs that ended in a contact with a side or the rear of the moving car."""
        return self.number_of(Touch.FLANK)

    @property
    def standing(self) -> int:
        """Crude runs that ended in a contact with a car slower than hit_speed."""
        return self.number_of(Touch.STANDING)

    @property
    def aborted(self) -> int:
        """Crude runs that were aborted."""
        return self.number_of(Touch.ABORTED)

    @property
    def subset_aborted(self) -> int | None:
        """Crossings of subset simulation that were aborted, with which it ended; null: none were."""
        return self.lost or None

    @property
    def note(self) -> str:
        """What to heed."""
        found = [CONDITIONAL] if self.value is not None and self.value < UNSEEN else []
        if self.lost:
            found.append(f"not known: {crossings_lost(self.lost)} in subset simulation; none of them counts as a miss")
        many = self.subsets is not None and len(self.subsets.levels) > 1
        if self.subsets is not None and many and float(np.std(self.subsets.estimates, ddof=1)) > (self.value or 0.0):
            found.append(UNEVEN)
        return "; ".join(found)


@dataclass(frozen=True, eq=False)
class Risks(Entry):
    """The risk of a car at all scales.

    Attributes:
        behaviour: the behaviour model, as in its file.
        scales: each scale s.
        failures: the most likely failures; null: no hit.
        failing: logs of those that are kept, by the numbers of their crude runs.
    """

    KEYS = "behaviour scales failures"

    behaviour: Mapping[str, Any]
    scales: Sequence[ScaleRisk]
    failures: Entry | None = None
    failing: Mapping[int, EpisodeLog] = field(default_factory=dict)

    def at(self, scale: float) -> ScaleRisk | None:
        """Return the risk at a scale; None where it was not asked for."""
        return next((one for one in self.scales if one.scale == scale), None)


def crossings_lost(count: int) -> str:
    """Return in words how many crossings were aborted."""
    return "1 crossing was aborted" if count == 1 else f"{count} crossings were aborted"


def log_t_interval(estimates: FloatArray) -> Interval | None:
    """Return the interval of the mean of estimates of a small probability: Student's, on the logarithm of the mean.

    The logarithm's error is that of the mean over the mean, which is to be above 0; None below two estimates.
    """
    if len(estimates) < 2:
        return None
    value = mean(estimates)
    error = float(np.std(estimates, ddof=1)) / math.sqrt(len(estimates)) / value
    reach = math.exp(student_quantile(len(estimates) - 1) * error)
    return value / reach, min(1.0, value * reach)
