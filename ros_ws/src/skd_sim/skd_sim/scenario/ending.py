"""When a scenario is over, and when the adversary comes into the car's path: regions beside and along the road.

A region is in road coordinates: how far to the right of the centre line, and how far along it from the crossing line.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from pydantic import ConfigDict

from skd_sim.errors import UsageError
from skd_sim.inputs.model import Frozen, limits
from skd_sim.scenario.road import is_straight_north, right_and_along, road_position
from skd_sim.world.state import FloatArray, Pair, Trajectory

_Bound = Annotated[float, limits(-500.0, 500.0, "m")] | None
NOWHERE = (math.inf, -math.inf, math.inf, -math.inf)
"""Bounds of an empty region."""


@dataclass(frozen=True)
class Region(Frozen):
    """Part of the ground without its edges. A bound that is not given does not limit it; without any it is nowhere.

    The first two bounds are offsets to the right of the road's centre line, m; the others are distances along it from
    the crossing line, m.
    """

    __pydantic_config__ = ConfigDict(extra="forbid", json_schema_extra={"also": ["lane"]})

    right_of: _Bound = None
    left_of: _Bound = None
    ahead_of: _Bound = None
    behind: _Bound = None

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Least and greatest offset to the right, least and greatest place along, m; infinite where not bounded."""
        given = (self.right_of, self.left_of, self.ahead_of, self.behind)
        if given == (None,) * 4:
            return NOWHERE
        low, high, first, last = given
        return (
            -math.inf if low is None else low,
            math.inf if high is None else high,
            -math.inf if first is None else first,
            math.inf if last is None else last,
        )


@dataclass(frozen=True)
class Endings(Frozen):
    """Section `ending` of a scenario: where the adversary has arrived, and where it cannot meet the car any more."""

    arrived: Region | None = None
    missed: Region | None = None


def inside(bounds: tuple[float, float, float, float], across: float, along: float) -> bool:
    """Return whether a place in road coordinates (m) is in the region that has these bounds (m)."""
    return bounds[0] < across < bounds[1] and bounds[2] < along < bounds[3]


@dataclass(frozen=True, eq=False)
class Ending(Frozen):
    """When an episode of one scenario is over; see the module.

    Attributes:
        line: the road's centre line (skd_sim/scenario/road.py).
        path_edge: offset (m) within which the adversary can reach into the strip that the car sweeps.
        crossing: 1 for an adversary that crosses to the right, −1 for one that crosses to the left.
        arrival: bounds of the region in which the adversary has arrived, m.
        loss: bounds of the region from which it cannot meet the car any more, m.
    """

    line: FloatArray
    path_edge: float
    crossing: float
    arrival: tuple[float, float, float, float]
    loss: tuple[float, float, float, float]

    @cached_property
    def _straight(self) -> bool:  # computed once: it is needed in every tick
        return bool(is_straight_north(self.line))

    def place(self, x: float, y: float) -> Pair:
        """Return how far to the right of the centre line a position (m) is, and where along it, m."""
        if self._straight:
            return x, y
        along, left = road_position(self.line, x, y)
        return -float(left), float(along)

    def arrived(self, x: float, y: float) -> bool:
        """Return whether the adversary, at (x, y) in m, has arrived."""
        return inside(self.arrival, *self.place(x, y))

    def missed(self, x: float, y: float) -> bool:
        """Return whether the adversary, at (x, y) in m, cannot meet the car any more."""
        return inside(self.loss, *self.place(x, y))

    def entry_time(self, trajectory: Trajectory) -> float:
        """Return when (s) a trajectory enters the strip that the car sweeps, by linear interpolation.

        Raises:
            UsageError: it never does.
        """
        across = right_and_along(self.line, trajectory.positions)[:, 0]
        entered = np.abs(across) <= self.path_edge
        entered[1:] |= np.sign(across[1:]) != np.sign(across[:-1])  # right through it within one step
        if not entered.any():
            edge, least = f"{self.path_edge:g} m to each side of the road's centre line", np.abs(across).min()
            raise UsageError(
                f"safe trajectory {trajectory.name!r} never enters the car's path ({edge}); least {least:.2f} m"
            )
        index = int(np.argmax(entered))
        if index == 0:
            return 0.0
        side = np.sign(across[index - 1])
        before, after = side * across[index - 1], side * across[index]
        return float((index - 1 + (before - self.path_edge) / (before - after)) * trajectory.time_step)


def ending_of(
    line: FloatArray, path_edge: float, start: float, destination: float | None, endings: Endings | None
) -> Ending:
    """Return the ending of a scenario; what its section `ending` does not say follows from the destination.

    Args:
        line: the road's centre line.
        path_edge: offset (m) within which the adversary can reach into the strip that the car sweeps.
        start: how far to the right of the centre line the adversary starts, m.
        destination: offset to the right of the centre line, m, at or beyond which the adversary has arrived.
        endings: section `ending` of the scenario, if it has one.
    """
    arrived, missed = (None, None) if endings is None else (endings.arrived, endings.missed)
    goal = destination
    if goal is None and arrived is not None:
        goal = arrived.left_of if arrived.right_of is None else arrived.right_of
    crossing = -1.0 if goal is not None and goal < start else 1.0
    arrival = _beyond(destination, crossing, whole=True) if arrived is None else arrived.bounds
    loss = _beyond(crossing * path_edge, crossing, whole=False) if missed is None else missed.bounds
    return Ending(line, path_edge, crossing, arrival, loss)


def _beyond(edge: float | None, crossing: float, *, whole: bool) -> tuple[float, float, float, float]:
    """Return the bounds of all that lies beyond an offset (m), with the offset itself (`whole`) or without."""
    if edge is None:
        return NOWHERE
    if crossing > 0.0:
        return math.nextafter(edge, -math.inf) if whole else edge, math.inf, -math.inf, math.inf
    return -math.inf, math.nextafter(edge, math.inf) if whole else edge, -math.inf, math.inf
