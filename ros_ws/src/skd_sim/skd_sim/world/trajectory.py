"""Trajectories: positions that are uniform in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skd_sim.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Positions in the world frame at times 0, time_step, 2·time_step, ….

    Attributes:
        positions: n × d array, m; n ≥ 1, finite.
        time_step: time between two positions, s, > 0.
        name: says where it comes from, for reports.
    """

    positions: FloatArray
    time_step: float
    name: str = ""

    def __post_init__(self) -> None:
        points = np.array(self.positions, dtype=np.float64)
        if points.ndim != 2 or points.shape[0] < 1 or points.shape[1] < 1:
            raise ValueError(f"a trajectory needs n × d positions with n ≥ 1, got shape {points.shape}")
        if not np.isfinite(points).all():
            raise ValueError(f"trajectory {self.name!r} has a position that is not finite")
        if not self.time_step > 0.0:
            raise ValueError(f"time step must be positive, got {self.time_step}")
        points.setflags(write=False)
        object.__setattr__(self, "positions", points)

    def __len__(self) -> int:
        return int(self.positions.shape[0])

    @property
    def duration(self) -> float:
        """Time from the first to the last position, s."""
        return (len(self) - 1) * self.time_step

    def prefix(self, count: int) -> Trajectory:
        """Return the first `count` positions (all, where there are fewer)."""
        return Trajectory(self.positions[: max(1, count)], self.time_step, self.name)
