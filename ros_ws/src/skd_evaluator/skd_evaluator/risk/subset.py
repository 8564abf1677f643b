"""Subset simulation: a small probability as a product of larger ones.

Level by level the tenth of the crossings that came nearest to a hit is kept, and others like them are made by moves
that leave the normals' law as it is (Au and Beck, Probabilistic Engineering Mechanics 16, 2001; how far the moves go
adapts as in Papaioannou, Betz, Zwirglmaier and Straub, ibid. 41, 2015). Each replicate is a simulation of its own, so
their spread says how good the mean is. Fewer than a thousand crossings a level are biased, and fewer than 16 replicates
give intervals that are too short.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from skd_sim.arrays import FloatArray, IntArray
from skd_sim.episode.randomness import Role, generator

from skd_evaluator.measure.risks import Subsets, Touch
from skd_evaluator.risk.crossings import Crossings, Encounter, Runner

REPLICATES: Final = 16
PER_LEVEL: Final = 1000
LEVELS: Final = 9
"""At most: what is less likely than 1e-9 is not told from 0."""
SHARE: Final = 10
"""One of so many crossings is kept for the next level."""
_STEP, _WANTED = 0.5, 0.44  # first step of the moves; share of them that should be accepted
_OTHER_PHI, _OTHER_DRAW = 0.1, 0.3  # how often a move changes φ, or the car's draws by number
_DRAWS = 1 << 31


@dataclass(frozen=True)
class Effort:
    """How much is simulated.

    Attributes:
        replicates: number of simulations.
        per_level: crossings of a level.
        levels: at most.
    """

    replicates: int = REPLICATES
    per_level: int = PER_LEVEL
    levels: int = LEVELS


class Replicate(NamedTuple):
    """What one simulation found: its estimate by φ, how many levels it had, and whether it came to a hit."""

    shares: FloatArray
    levels: int
    reached: bool


def replicate(encounter: Encounter, runner: Runner, scale: float, number: int, effort: Effort) -> Replicate:
    """Run one simulation.

    Args:
        encounter: what the crossings share.
        runner: runs them.
        scale: of the behaviour.
        number: of the replicate, from which its draws follow.
        effort: how much.
    """
    rng = generator(encounter.plan.seed, number, Role.RISK, round(1000 * scale))
    count, phis = effort.per_level, len(encounter.safe)
    kept = count // SHARE
    now = Crossings(
        (np.arange(count) + int(rng.integers(phis))) % phis,
        rng.standard_normal((count, encounter.walker_normals)),
        rng.standard_normal((count, runner.car_normals)),
        _DRAWS + rng.integers(_DRAWS, size=count),
    )
    ends = runner.run(now, scale)
    touch, clearance = ends.touch, ends.clearance
    probability, step = 1.0, _STEP
    for level in range(1, effort.levels + 1):
        order = np.argsort(clearance, kind="stable")
        threshold = float(clearance[order[kept - 1]])
        hits = touch == Touch.FRONT
        if threshold <= 0.0 or level == effort.levels:
            on_phi = np.bincount(now.phi[hits], minlength=phis) / count
            return Replicate(probability * on_phi, level, bool(hits.any()))
        probability *= kept / count
        now, touch, clearance, step = _next_level(now.of(order[:kept]), touch[order[:kept]], clearance[order[:kept]],
                                                  threshold, count, runner, scale, phis, step, rng)  # fmt: skip
    raise AssertionError("the last level returns")


def _next_level(
    seeds: Crossings,
    touch: IntArray,
    clearance: FloatArray,
    threshold: float,
    count: int,
    runner: Runner,
    scale: float,
    phis: int,
    step: float,
    rng: np.random.Generator,
) -> tuple[Crossings, IntArray, FloatArray, float]:
    """Return the crossings of the next level, how they ended, and the step to begin with in the one after it."""
    parts, touches, clearances = [seeds], [touch], [clearance]
    now = seeds
    for turn in range(1, count // len(seeds)):
        trial = _moved(now, step, phis, rng)
        ends = runner.run(trial, scale)
        fine = ends.clearance <= threshold
        now = now.where(fine, trial)
        touch, clearance = np.where(fine, ends.touch, touch), np.where(fine, ends.clearance, clearance)
        parts.append(now)
        touches.append(touch)
        clearances.append(clearance)
        step = min(0.999, step * math.exp((float(fine.mean()) - _WANTED) / math.sqrt(turn)))
    whole = Crossings(
        np.concatenate([one.phi for one in parts]),
        np.concatenate([one.walker for one in parts]),
        np.concatenate([one.car for one in parts]),
        np.concatenate([one.draw for one in parts]),
    )
    return whole, np.concatenate(touches), np.concatenate(clearances), step


def _moved(now: Crossings, step: float, phis: int, rng: np.random.Generator) -> Crossings:
    """Return crossings near some: each normal moved, φ and the car's draws by number exchanged now and then."""
    keep = math.sqrt(1.0 - step * step)
    other_phi = rng.random(len(now)) < _OTHER_PHI
    other_draw = rng.random(len(now)) < _OTHER_DRAW
    return Crossings(
        np.where(other_phi, rng.integers(phis, size=len(now)), now.phi),
        keep * now.walker + step * rng.standard_normal(now.walker.shape),
        keep * now.car + step * rng.standard_normal(now.car.shape),
        np.where(other_draw, _DRAWS + rng.integers(_DRAWS, size=len(now)), now.draw),
    )


def gathered(found: list[Replicate], effort: Effort) -> Subsets:
    """Return what the replicates found together."""
    return Subsets(
        np.array([one.shares for one in found]),
        np.array([one.levels for one in found], np.int64),
        effort.per_level,
        sum(not one.reached for one in found),
    )
