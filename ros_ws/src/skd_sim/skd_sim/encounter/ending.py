"""When an encounter is over, and when the adversary comes into the car's path: by its offset from the centre line."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from skd_sim.arrays import FloatArray
from skd_sim.encounter.road import is_straight_north, right_and_along, road_position
from skd_sim.encounter.unchanging import Unchanging
from skd_sim.errors import UsageError
from skd_sim.geometry.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Ending(Unchanging):
    """Of one scenario.

    Attributes:
        line: the road's centre line (skd_sim/encounter/road.py).
        path_edge: offset (m) within which the adversary can reach into the strip that the car sweeps.
        destination: offset to the right (m) at which the adversary has arrived.
    """

    line: FloatArray
    path_edge: float
    destination: float

    @cached_property
    def _straight(self) -> bool:  # known once: it is asked in every tick
        return bool(is_straight_north(self.line))

    def across(self, x: float, y: float) -> float:
        """Return how far to the right of the centre line a position (m) is, m; on the straight lane its x."""
        return x if self._straight else -float(road_position(self.line, x, y)[1])

    def arrived(self, x: float, y: float) -> bool:
        """Return whether the adversary, at (x, y) in m, is where it wanted to go."""
        return self.across(x, y) >= self.destination

    def missed(self, x: float, y: float) -> bool:
        """Return whether it has left the car's path to the right; from there no action leads straight back."""
        return self.across(x, y) > self.path_edge

    def entry_time(self, trajectory: Trajectory) -> float:
        """Return when (s) a trajectory enters the strip that the car sweeps, by linear interpolation.

        Raises:
            UsageError: it never does.
        """
        across = right_and_along(self.line, trajectory.positions)[:, 0]
        entered = np.abs(across) <= self.path_edge
        entered[1:] |= np.sign(across[1:]) != np.sign(across[:-1])  # right through it within one step
        if not entered.any():
            least, edge = np.abs(across).min(), self.path_edge
            if self._straight:
                missed = f"(|x| ≤ {edge:g} m); its least |x| is {least:.2f} m: a safe trajectory has to cross x = 0"
            else:
                missed = (
                    f"({edge:g} m to each side of the road's centre line); it comes within {least:.2f} m of the line: "
                    "a safe trajectory has to cross it"
                )
            raise UsageError(f"safe trajectory {trajectory.name!r} never enters the car's path {missed}")
        index = int(np.argmax(entered))
        if index == 0:
            return 0.0
        side = np.sign(across[index - 1])
        before, after = side * across[index - 1], side * across[index]
        return float((index - 1 + (before - self.path_edge) / (before - after)) * trajectory.time_step)
