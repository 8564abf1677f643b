"""Crossings of which a risk is made: who walks, as which normals say, and what became of it.

A crossing is a φ, a row of the walker's standard normals, and the draws of the car: a row of standard normals where all
that the car does is known, else the number by which an episode draws them. A model runs crossings and says how each
ended and by how much time the front of the moving car missed: 0 where it hit, and more than that where it did not.

With which side of the car the walker was touched, and by how much time a hit by its moving front was missed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Final, Protocol, Self

import numpy as np
import numpy.typing as npt
from skd_sim.arrays import FloatArray, IntArray
from skd_sim.kernels.compilation import kernel
from skd_sim.world.contact import to_car_frame
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.plan import Plan
from skd_evaluator.metrics.behaviour.model import normals_of


class _Rows:
    """Arrays, or None, of which row k is of crossing k."""

    def _arrays(self) -> list[npt.NDArray[Any] | None]:
        return [getattr(self, one.name) for one in fields(self)]  # type: ignore[arg-type]

    def of(self, rows: IntArray) -> Self:
        """Return some of them."""
        return type(self)(*(None if one is None else one[rows] for one in self._arrays()))

    @classmethod
    def together(cls, parts: Sequence[Self]) -> Self:
        """Return several as one."""
        columns = zip(*(one._arrays() for one in parts), strict=True)
        return cls(*(None if any(one is None for one in column) else np.concatenate(column) for column in columns))

    def where(self, chosen: npt.NDArray[np.bool_], other: Self) -> Self:
        """Return the rows of `other` where `chosen`, else these."""
        both = zip(self._arrays(), other._arrays(), strict=True)
        return type(self)(*(None if a is None or b is None else np.where(_like(chosen, a), b, a) for a, b in both))


def _like(chosen: npt.NDArray[np.bool_], array: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    return chosen.reshape(-1, *(1,) * (array.ndim - 1))


@dataclass(frozen=True, eq=False)
class Crossings(_Rows):
    """Some crossings.

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


@dataclass(frozen=True, eq=False)
class Ends(_Rows):
    """How crossings ended.

    Attributes:
        touch: of each, a `Touch`.
        missed: least time by which the front of the moving car missed, s (`missed_by`); 0 where, and only where, it
            hit.
        ticks: how many each had, that of a contact included.
    """

    touch: IntArray
    missed: FloatArray
    ticks: IntArray | None = None


class CrossingModel(Protocol):
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


SAME: Final = 1e-6
"""m by which a touching disc's distance may differ from its radius."""
IN_A_CURVE: Final = 0.01
"""The same in a curve, whose arcs the contact test takes for chords."""
_PARTS: Final = 4  # of a tick, at whose ends it is looked at by how much a hit is missed
_SLOWEST: Final = 0.2  # m/s; a walker beside the car's way who stands, or goes away, counts as if walking there so

CREEPING: Final = 0.6
"""m/s; a car that is less than that faster than a hit counts as if it were so much faster.

Else a car that rolls up to a walker is as far from a hit as one that stands, a hit by it is near nothing, and one that
is found by luck stays in all levels: such replicates were seven times as large as others.
"""


@kernel
def in_car_frame(
    path: FloatArray, here: tuple[float, float], there: tuple[float, float], share: float
) -> tuple[float, float, float]:
    """Return where the walker is in the car's frame at a share of the tick, and the car's speed there."""
    before, after = path[0], path[1]
    x, y = here[0] + share * (there[0] - here[0]), here[1] + share * (there[1] - here[1])
    car_x, car_y = before[0] + share * (after[0] - before[0]), before[1] + share * (after[1] - before[1])
    ahead, left = to_car_frame(x, y, car_x, car_y, before[2] + share * (after[2] - before[2]))
    return ahead, left, before[3] + share * (after[3] - before[3])


@kernel
def side_touched(
    ahead: float,
    left: float,
    footprint: tuple[float, float, float],
    radius: float,
    impact: float,
    hit_speed: float,
    same: float,
) -> int:
    """Return how a touch counts, a `Touch`.

    A disc that touches a side has its centre a radius beside it; one whose centre is nearer to the axis touches front
    or rear, or one of their corners. In a curve it is not known as exactly how far beside it is, and near the radius it
    tells whether the centre is ahead of the front, where nothing but a corner is.

    Args:
        ahead: how far the disc's centre is ahead of the car's reference point at the contact, m.
        left: how far it is to the left of the car's axis, m.
        footprint: of the car: front, rear and half width, m.
        radius: of the disc, m.
        impact: speed of the car at the contact, m/s.
        hit_speed: of a hit, at the least, m/s.
        same: how exactly the offset to the left is known, m: `SAME`, or `IN_A_CURVE`.
    """
    if impact < hit_speed:
        return 3
    front, rear, half_width = footprint
    if abs(left) >= half_width + radius - SAME or ahead <= 0.5 * (front - rear):
        return 2
    return 2 if ahead <= front and abs(left) >= half_width + radius - same else 1


@kernel
def missed_by(
    path: FloatArray,
    here: tuple[float, float],
    there: tuple[float, float],
    until: float,
    footprint: tuple[float, float, float],
    radius: float,
    hit_speed: float,
    time_step: float,
) -> float:
    """Return the least time by which a disc misses the front of the moving car in a tick, s; infinity if it stands.

    Ahead that is the distance over how much faster than a hit the car is: of a car that brakes at b and comes to that
    speed a distance m short of a walker it is never less than √(2m/b), or m over `CREEPING`, so that crossings are
    ordered by m, and a car that creeps, and can stop at once, is far from a hit, though not out of reach of one. To the
    side it is the distance over how fast the disc comes: a walker who stands beside the way of the car, or has left
    it, is far from a hit, however near.

    It orders crossings by how near they are to a hit, and no more hangs on it: it is looked at some times in a tick.

    Args:
        path: of the car in the tick, its two ends, 2 × 4.
        here: where the walker is when the tick begins, m.
        there: and when it ends, m.
        until: share of the tick up to which to look.
        footprint: of the car: front, rear and half width, m.
        radius: of the disc, m.
        hit_speed: speed of the car above which it moves, m/s.
        time_step: duration of the tick, s.
    """
    least = math.inf
    _, before, _ = in_car_frame(path, here, there, 0.0)
    _, after, _ = in_car_frame(path, here, there, 1.0)
    to_the_left = (after - before) / time_step
    for part in range(_PARTS + 1):
        ahead, left, speed = in_car_frame(path, here, there, until * part / _PARTS)
        if speed > hit_speed:
            aside = max(0.0, abs(left) - footprint[2])
            off = ahead - footprint[0]
            apart = math.sqrt(off * off + aside * aside)
            if apart <= radius:
                return 0.0
            outside = 1.0 - radius / apart
            comes = max(_SLOWEST, -to_the_left if left > 0.0 else to_the_left)
            along, across = outside * off / max(speed - hit_speed, CREEPING), outside * aside / comes
            least = min(least, math.sqrt(along * along + across * across))
    return least
