"""Crossings of which a risk is made: who walks, as which normals say, and what became of it.

A crossing is a φ, a row of the walker's standard normals, and the draws of the car: a row of standard normals where all
that the car does is known, else the number by which an episode draws them. Whoever runs crossings says how each ended
and by how much time the front of the moving car missed: 0 where it hit, and more than that where it did not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt
from skd_sim.arrays import FloatArray, IntArray
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.plan.plan import Plan
from skd_evaluator.metrics.behaviour.walking import normals_of


@dataclass(frozen=True, eq=False)
class Crossings:
    """Some crossings; row k of each array is of crossing k.

    Attributes:
        phi: number of φ.
        walker: standard normals of the walker.
        car: standard normals of the car, none of one that draws by number.
        draw: number of the car's draws, of one that does.
    """

    phi: IntArray
    walker: FloatArray
    car: FloatArray
    draw: IntArray

    def __len__(self) -> int:
        return len(self.phi)

    def of(self, rows: IntArray) -> Crossings:
        """Return some of them."""
        return Crossings(self.phi[rows], self.walker[rows], self.car[rows], self.draw[rows])

    @staticmethod
    def together(parts: Sequence[Crossings]) -> Crossings:
        """Return several crossings as one."""
        return Crossings(
            np.concatenate([one.phi for one in parts]),
            np.concatenate([one.walker for one in parts]),
            np.concatenate([one.car for one in parts]),
            np.concatenate([one.draw for one in parts]),
        )

    def where(self, chosen: npt.NDArray[np.bool_], other: Crossings) -> Crossings:
        """Return the crossings of `other` where `chosen`, else these."""
        column = chosen[:, None]
        return Crossings(
            np.where(chosen, other.phi, self.phi),
            np.where(column, other.walker, self.walker),
            np.where(column, other.car, self.car),
            np.where(chosen, other.draw, self.draw),
        )


@dataclass(frozen=True, eq=False)
class Ends:
    """How crossings ended.

    Attributes:
        touch: of each, a `Touch`.
        missed: least time by which the front of the moving car missed, s (`touching.missed_by`); 0 where, and only
            where, it hit.
        ticks: how many each had, that of a contact included; None: nobody asks, as in subset simulation.
    """

    touch: IntArray
    missed: FloatArray
    ticks: IntArray | None = None

    def of(self, rows: IntArray) -> Ends:
        """Return some of them."""
        return Ends(self.touch[rows], self.missed[rows])

    @staticmethod
    def together(parts: Sequence[Ends]) -> Ends:
        """Return several as one."""
        ticks = [one.ticks for one in parts if one.ticks is not None]
        return Ends(
            np.concatenate([one.touch for one in parts]),
            np.concatenate([one.missed for one in parts]),
            np.concatenate(ticks) if len(ticks) == len(parts) else None,
        )

    def where(self, chosen: npt.NDArray[np.bool_], other: Ends) -> Ends:
        """Return the ends of `other` where `chosen`, else these."""
        touch = np.where(chosen, other.touch, self.touch)
        return Ends(touch, np.where(chosen, other.missed, self.missed))


class Runner(Protocol):
    """Runs crossings of one car."""

    car_normals: int
    """How many normals the car's draws are made of."""

    def run(self, crossings: Crossings, scale: float) -> Ends:
        """Run crossings at a scale."""


@dataclass(frozen=True, eq=False)
class CrossingPlan:
    """What all crossings of a car share.

    Attributes:
        plan: of the assessment.
        safe: φ.
        values: parameters of the behaviour model, in the order of `MEANINGS`.
    """

    plan: Plan
    safe: tuple[Trajectory, ...]
    values: FloatArray

    @property
    def ticks(self) -> int:
        """Ticks of a crossing, at most."""
        return self.plan.scenario.ticks

    @property
    def walker_normals(self) -> int:
        """How many normals a walker is made of."""
        return normals_of(self.ticks)
