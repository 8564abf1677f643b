"""Kinds of road user that remember two numbers of how they moved: what they can do in each tick of a way."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.scenario.scenario import Scenario

from skd_adversary.crossing.parts import Motion, Own, RoadUserKernels, RoadUserModel
from skd_adversary.crossing.safe_path import path_velocities


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
    return RoadUserModel(name, kernels, parameters, choices, as_phi, fastest, height, motion=motion)


def _choices(motion: Motion, action_count: int, scenario: Scenario, path: FloatArray, way: FloatArray) -> FloatArray:
    """Return the velocities of all actions in each tick of a way; see `RoadUserModel`."""
    actions = range(action_count)
    found = [[motion.velocity(scenario, own, one) for one in actions] for own in _so_far(motion, scenario, path, way)]
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
