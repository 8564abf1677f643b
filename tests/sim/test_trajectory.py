from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from skd_sim.world.state import Trajectory

POINTS = np.arange(10.0).reshape(5, 2)


def test_positions_are_a_copy_and_read_only() -> None:
    points = POINTS.copy()
    trajectory = Trajectory(points, 0.3)
    points[0, 0] = 99.0
    assert trajectory.positions[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        trajectory.positions[0, 0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        trajectory.time_step = 1.0  # type: ignore[misc]


@pytest.mark.parametrize("points", [np.empty((0, 2)), np.empty((3, 0)), np.zeros(3), np.zeros((2, 2, 2))])
def test_wrong_shape(points: np.ndarray) -> None:
    with pytest.raises(ValueError, match="n × d"):
        Trajectory(points, 0.3)
