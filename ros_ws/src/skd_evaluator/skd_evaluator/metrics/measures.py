"""Further measures of a pair (φ, ψ), by name: what a measure is, and its mean over the pairs of an assessment.

SKD's own stand in `MEASURES`; an installed package adds one by an entry point of group `skd.measures` that leads to a
`Measure`. Each is computed in every assessment.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from skd_sim.errors import UsageError
from skd_sim.options.registry import Registry, reason_of
from skd_sim.world.episode import EpisodeLog
from skd_sim.world.state import FloatArray, Trajectory

from skd_evaluator.metrics.clustered import GroupedMean, Prior
from skd_evaluator.metrics.entry import Entry

MEASURES = Registry(
    "measure",
    "skd.measures",
    {
        "warped": "skd_evaluator.metrics.frechet:WARPED",
        "required_deceleration_at_entry": "skd_evaluator.metrics.contact_place:DECELERATION_AT_ENTRY",
    },
)


@dataclass(frozen=True, eq=False)
class Pair:
    """A safe trajectory and a kamikaze episode that collided.

    Attributes:
        log: what happened in the episode; its specification has the scenario.
        psi: ψ, up to the place of the contact.
        duration: time of the contact, in ticks since the start.
    """

    log: EpisodeLog
    psi: Trajectory
    duration: float


def pair_of(log: EpisodeLog) -> Pair:
    """Return the pair of an episode that collided."""
    return Pair(log, log.trajectory, log.impact_time / log.episode.scenario.time_step)


@dataclass(frozen=True)
class Measure:
    """A measure of pairs.

    Attributes:
        label: what it is called in tables.
        unit: unit of its values; empty: none.
        of: (φ, the pairs of this φ) → one number a pair, nan where it is not defined.
        shown: whether the terminal's table has it.
        prior: what its interval over φ takes as known beforehand; nothing: Student's t.
    """

    label: str
    unit: str
    of: Callable[[Trajectory, Sequence[Pair]], npt.ArrayLike]
    shown: bool = True
    prior: Prior | None = None


@dataclass(frozen=True, eq=False)
class Measured(Entry):
    """A measure's values.

    Attributes:
        measure: what was measured.
        groups: the value of each pair that counts, by φ; nan: not defined.
        confidence: confidence of the interval over φ.
        error: why it could not be computed, in one line; None: it was.
    """

    KEYS = (
        "label=measure.label unit=measure.unit shown=measure.shown mean=known.mean ci95_pairs=known.plain_interval "
        "ci95=known.interval pairs undefined error"
    )

    measure: Measure
    groups: tuple[FloatArray, ...]
    confidence: float
    error: str | None = None

    @cached_property
    def known(self) -> GroupedMean:
        """The values that are defined."""
        known = tuple(values[np.isfinite(values)] for values in self.groups)
        return GroupedMean(known, self.measure.prior, (-math.inf, math.inf), self.confidence)

    @property
    def pairs(self) -> int:
        """Pairs in which it is defined."""
        return int(self.known.values.size)

    @property
    def undefined(self) -> int:
        """Pairs in which it is not defined."""
        return sum(map(len, self.groups)) - self.pairs


def load_measures() -> dict[str, Measure]:
    """Return all measures by name.

    Raises:
        UsageError: one cannot be loaded, or is none.
    """
    found = {name: MEASURES.find(name) for name in MEASURES.names()}
    for name, measure in found.items():
        if not isinstance(measure, Measure):
            raise UsageError(f"measure {name!r} ({MEASURES.target(name)}) must be a Measure, got {measure!r:.60}")
    return found


def measure_pairs(
    groups: Sequence[tuple[Trajectory, Sequence[Pair]]], kept: Sequence[npt.NDArray[np.int64]], confidence: float
) -> dict[str, Measured]:
    """Return every measure of all pairs, by name.

    A measure that is not SKD's own and fails is said to have failed: what was run before must not be lost by it.

    Args:
        groups: each φ with its pairs.
        kept: the pairs that count, for each φ.
        confidence: confidence of the intervals over φ.

    Raises:
        UsageError: the trajectories of a pair do not go together.
    """
    found = {}
    for name, measure in load_measures().items():
        try:
            values = [_values(measure, phi, pairs)[rows] for (phi, pairs), rows in zip(groups, kept, strict=True)]
            found[name] = Measured(measure, tuple(values), confidence)
        except Exception as error:
            if name in MEASURES.own:
                raise
            found[name] = Measured(measure, (), confidence, reason_of(error))
    return found


def _values(measure: Measure, phi: Trajectory, pairs: Sequence[Pair]) -> FloatArray:
    """Return the values of the pairs of one φ.

    Raises:
        ValueError: they are not one number a pair.
    """
    values = np.asarray(measure.of(phi, pairs), dtype=np.float64)
    if values.shape != (len(pairs),):
        raise ValueError(f"it gave an array of shape {values.shape} for {len(pairs)} pairs, not one number each")
    return values
