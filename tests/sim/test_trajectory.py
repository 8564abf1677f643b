from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from skd_sim.world.state import Trajectory

POINTS = np.arange(10.0).reshape(5, 2)


def test_length_and_duration() -> None:
    trajectory = Trajectory(POINTS, 0.3, "walk")
    assert len(trajectory) == 5
    assert trajectory.duration == pytest.approx(1.2)
    assert Trajectory([[1.0, 2.0]], 0.3).duration == 0.0  # type: ignore[arg-type]


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


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_not_finite(bad: float) -> None:
    with pytest.raises(ValueError, match="'walk' has a position that is not finite"):
        Trajectory(np.array([[0.0, bad]]), 0.3, "walk")


@pytest.mark.parametrize("time_step", [0.0, -0.3, math.nan])
def test_wrong_time_step(time_step: float) -> None:
    with pytest.raises(ValueError, match="time step"):
        Trajectory(POINTS, time_step)
