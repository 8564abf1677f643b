"""Kinds of road user that remember two numbers of how they moved: what they can do in each tick of a way."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.encounter.scenario import Scenario

from skd_adversary.model.parts import RoadUserKernels, RoadUserModel
from skd_adversary.model.safe_path import path_velocities

Own = tuple[float, float]
"""What the kind remembers, in units of its own."""


class Motion(NamedTuple):
    """How such a kind moves, outside kernels.

    Attributes:
        first: (scenario, φ) → what it remembers before its first step.
        after: (remembered, vx, vy) → what it remembers after a step at a velocity, m/s.
        choices: (scenario, remembered) → velocities of all its actions, m/s.
        nearest: (scenario, remembered, vx, vy) → the velocity that it can have that comes nearest to a wanted one, m/s.
    """

    first: Callable[[Scenario, FloatArray], Own]
    after: Callable[[Own, float, float], Own]
    choices: Callable[[Scenario, Own], list[tuple[float, float]]]
    nearest: Callable[[Scenario, Own, float, float], tuple[float, float]]


def road_user(
    name: str,
    kernels: RoadUserKernels,
    parameters: Callable[[Scenario], Mapping[str, Any]],
    motion: Motion,
    fastest: float,
    height: float,
) -> RoadUserModel:
    """Return a kind that moves so; for the other arguments see `RoadUserModel`."""
    choices, as_phi = functools.partial(_choices, motion, kernels.action_count), functools.partial(_as_phi, motion)
    return RoadUserModel(name, kernels, parameters, choices, as_phi, fastest, height)


def _choices(motion: Motion, action_count: int, scenario: Scenario, path: FloatArray, way: FloatArray) -> FloatArray:
    """Return the velocities of all actions in each tick of a way; see `RoadUserModel`."""
    found = [motion.choices(scenario, own) for own in _so_far(motion, scenario, path, way)]
    return np.array(found).reshape(-1, action_count, 2)


def _as_phi(motion: Motion, scenario: Scenario, path: FloatArray, way: FloatArray) -> FloatArray:
    """Return its velocities as φ, or as near to that as it can, in each tick of a way; see `RoadUserModel`."""
    wanted = path_velocities(path, len(way) - 1, scenario.time_step)
    so_far = _so_far(motion, scenario, path, way)
    moved = [motion.nearest(scenario, own, vx, vy) for own, (vx, vy) in zip(so_far, wanted.tolist(), strict=True)]
    return np.array(moved).reshape(-1, 2)


def _so_far(motion: Motion, scenario: Scenario, path: FloatArray, way: FloatArray) -> Iterator[Own]:
    """Yield what it remembers at the begin of each tick of a way (n × 2, m)."""
    own = motion.first(scenario, path)
    for vx, vy in (np.diff(way, axis=0) / scenario.time_step).tolist():
        yield own
        own = motion.after(own, vx, vy)
