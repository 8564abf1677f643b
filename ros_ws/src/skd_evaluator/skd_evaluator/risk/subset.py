"""Subset simulation: a small probability as a product of larger ones.

Level by level the crossings that came nearest to a hit are kept, and others like them are made by moves that leave the
normals' law as it is (Au and Beck, Probabilistic Engineering Mechanics 16, 2001). A first simulation finds the levels,
each reached by a tenth of the crossings of the one before, and how far moves go (Papaioannou, Betz, Zwirglmaier and
Straub, ibid. 41, 2015). The replicates take both as they are: with levels of their own, as first published, estimates
are 5 to 10 % too large; with levels that are fixed, and those that go on drawn by lot, they have no bias (Dau and
Chopin, Journal of the Royal Statistical Society B 84, 2022). Each is a simulation of its own, so their spread says how
good the mean is; fewer than 16 give intervals that are too short.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from skd_sim.errors import AssessmentError
from skd_sim.world.episode import Role, generator
from skd_sim.world.state import FloatArray

from skd_evaluator.metrics.behaviour.model import OF_PERSON
from skd_evaluator.metrics.risks import Subsets, Touch, crossings_lost
from skd_evaluator.risk.crossings import CrossingModel, CrossingPlan, Crossings, Ends

REPLICATES: Final = 16
PER_LEVEL: Final = 1000
LEVELS: Final = 9
"""At most: what is less likely than 1e-9 is taken for 0."""
SHARE: Final = 10
"""One of so many crossings is kept for the next level."""
_STEP, _ACCEPTED = 0.5, 0.44  # first step of the moves; share of them that should be accepted
_MOVED = (1.0, 1.0, 1.0), (0.5, 0.12, 0.05)
"""Shares of the normals that moves of each kind change: the walker's of each tick, the car's, and the car's start.

The fewer, the further they can go. The person's are always moved, for the whole crossing hangs on them. What a car
draws early, and where it starts, decides in which tick it brakes: a move of that seldom stays within a level, and then
all else that it moved was in vain.
"""
_ALL_EVERY = 4  # moves in a row, of which one is of all normals: a car may hang on one normal alone
_OTHER_PHI, _OTHER_DRAW = 0.1, 0.3  # how often a move changes φ, or the car's draws by number
_DRAWS = 1 << 31
_PARTS = 256  # shares of the normals are drawn in so many parts: whole bytes cost least
_FIRST = 1 << 20  # number of the simulation that finds the levels


@dataclass(frozen=True)
class SubsetEffort:
    """How much is simulated.

    Attributes:
        replicates: number of simulations.
        per_level: crossings of a level.
        levels: at most.
    """

    replicates: int = REPLICATES
    per_level: int = PER_LEVEL
    levels: int = LEVELS


class AbortedCrossingsError(AssessmentError):
    """Crossings of a simulation were aborted: whether they are hits is not known, and no estimate can leave them out.

    Attributes:
        count: how many of those that were run together.
    """

    def __init__(self, count: int) -> None:
        """Say how many."""
        super().__init__(f"{crossings_lost(count)} in subset simulation")
        self.count = count


class Levels(NamedTuple):
    """What all replicates share.

    Attributes:
        thresholds: by how much time a hit is missed at most in each level but the first, s.
        steps: how far moves go in each of them: those of all normals, and those of some.
    """

    thresholds: tuple[float, ...]
    steps: tuple[tuple[float, float], ...]


class Replicate(NamedTuple):
    """What one simulation found: its estimate by φ, how many levels it had, and whether it came to a hit."""

    shares: FloatArray
    levels: int
    reached: bool


def levels_of(crossing_plan: CrossingPlan, model: CrossingModel, scale: float, effort: SubsetEffort) -> Levels:
    """Find the levels by a simulation whose own estimate is not used.

    Raises:
        AbortedCrossingsError: crossings of it were aborted.
    """
    count, rng = effort.per_level, generator(crossing_plan.plan.seed, _FIRST, Role.RISK, round(1000 * scale))
    now, ends = _begun(crossing_plan, model, scale, count, rng)
    thresholds: list[float] = []
    steps: list[tuple[float, float]] = []
    step = [_STEP, _STEP]
    while len(steps) < effort.levels - 1:
        order = np.argsort(ends.missed, kind="stable")[: count // SHARE]
        threshold = float(ends.missed[order[-1]])
        if threshold <= 0.0:
            break
        parts = [(now.of(order), ends.of(order))]
        for turn in range(1, SHARE):
            kind = _kind(turn)
            crossings, after, share = _next(*parts[-1], threshold, kind, step[kind], crossing_plan, model, scale, rng)
            parts.append((crossings, after))
            tries = sum(_kind(one) == kind for one in range(1, turn + 1))
            step[kind] = min(0.999, step[kind] * math.exp((share - _ACCEPTED) / math.sqrt(tries)))
        thresholds.append(threshold)
        steps.append((step[0], step[1]))
        now, ends = Crossings.together([one for one, _ in parts]), Ends.together([one for _, one in parts])
    return Levels(tuple(thresholds), tuple(steps))


def replicate(
    crossing_plan: CrossingPlan, model: CrossingModel, scale: float, effort: SubsetEffort, levels: Levels, number: int
) -> Replicate:
    """Run one simulation.

    Args:
        crossing_plan: what the crossings share.
        model: runs them.
        scale: of the behaviour.
        effort: how much.
        levels: as `levels_of` has found them.
        number: of the replicate, from which its draws follow.

    Raises:
        AbortedCrossingsError: crossings of it were aborted.
    """
    count, rng = effort.per_level, generator(crossing_plan.plan.seed, number, Role.RISK, round(1000 * scale))
    phis, probability = len(crossing_plan.safe), 1.0
    now, ends = _begun(crossing_plan, model, scale, count, rng)
    for level, (threshold, step) in enumerate(zip(*levels, strict=True), start=1):
        inside = np.flatnonzero(ends.missed <= threshold)
        if not inside.size:
            return Replicate(np.zeros(phis), level, False)
        probability *= inside.size / count
        chosen = np.resize(rng.permutation(inside), count // SHARE)  # each at most once, where there are as many
        parts = [(now.of(chosen), ends.of(chosen))]
        for turn in range(1, SHARE):
            kind = _kind(turn)
            crossings, after, _ = _next(*parts[-1], threshold, kind, step[kind], crossing_plan, model, scale, rng)
            parts.append((crossings, after))
        now, ends = Crossings.together([one for one, _ in parts]), Ends.together([one for _, one in parts])
    hits = ends.touch == Touch.FRONT
    on_phi = np.bincount(now.phi[hits], minlength=phis) / count
    return Replicate(probability * on_phi, 1 + len(levels.steps), bool(hits.any()))


def _begun(
    crossing_plan: CrossingPlan, model: CrossingModel, scale: float, count: int, rng: np.random.Generator
) -> tuple[Crossings, Ends]:
    """Return the crossings of the first level, which are not chosen, and how they ended."""
    phis = len(crossing_plan.safe)
    crossings = Crossings(
        (np.arange(count) + int(rng.integers(phis))) % phis,
        rng.standard_normal((count, crossing_plan.walker_normals)),
        rng.standard_normal((count, model.car_normals)),
        _DRAWS + rng.integers(_DRAWS, size=count),
    )
    return crossings, _run(model, crossings, scale)


def _run(model: CrossingModel, crossings: Crossings, scale: float) -> Ends:
    """Run crossings.

    Raises:
        AbortedCrossingsError: some were aborted.
    """
    ends = model.run(crossings, scale)
    if lost := int((ends.touch == Touch.ABORTED).sum()):
        raise AbortedCrossingsError(lost)
    return ends


def _kind(turn: int) -> int:
    """Return of which kind a move is: 0: of all normals; 1: of some."""
    return 0 if turn % _ALL_EVERY == 2 else 1


def _next(
    now: Crossings,
    ends: Ends,
    threshold: float,
    kind: int,
    step: float,
    crossing_plan: CrossingPlan,
    model: CrossingModel,
    scale: float,
    rng: np.random.Generator,
) -> tuple[Crossings, Ends, float]:
    """Return crossings after a move within a level, how they ended, and the share of the moves that were accepted."""
    trial = _moved(now, _MOVED[kind], step, len(crossing_plan.safe), rng)
    found = _run(model, trial, scale)
    fine = found.missed <= threshold
    return now.where(fine, trial), ends.where(fine, found), float(fine.mean())


def _moved(
    now: Crossings, shares: tuple[float, float, float], step: float, phis: int, rng: np.random.Generator
) -> Crossings:
    """Return crossings near some: all normals moved or some, φ and the car's draws exchanged now and then."""
    keep, count = math.sqrt(1.0 - step * step), len(now)
    of_walker, of_car, of_start = shares

    def some(shape: tuple[int, ...], share: float) -> npt.NDArray[np.bool_]:
        return rng.integers(_PARTS, size=shape, dtype=np.uint8) < round(_PARTS * share)

    def near(normals: FloatArray, moves: npt.NDArray[np.bool_]) -> FloatArray:
        trial = rng.standard_normal(normals.shape)
        trial *= step
        trial += keep * normals
        return np.where(moves, trial, normals)

    walker, car = some(now.walker.shape, of_walker), some(now.car.shape, of_car)
    walker[:, : len(OF_PERSON)] = True
    car[:, :1] = some(car[:, :1].shape, of_start)  # of a car that is known, its first normal
    other_phi = rng.random(count) < _OTHER_PHI
    other_draw = rng.random(count) < _OTHER_DRAW
    return Crossings(
        np.where(other_phi, rng.integers(phis, size=count), now.phi),
        near(now.walker, walker),
        near(now.car, car),
        np.where(other_draw, _DRAWS + rng.integers(_DRAWS, size=count), now.draw),
    )


def gathered(found: Sequence[Replicate], effort: SubsetEffort) -> Subsets:
    """Return what the replicates found together."""
    return Subsets(
        np.array([one.shares for one in found]),
        np.array([one.levels for one in found], np.int64),
        effort.per_level,
        sum(not one.reached for one in found),
    )
