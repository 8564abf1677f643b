"""Actions of the adversary that are drawn: velocities, from all that its road user can have from its state.

Whatever is wanted goes through the gate that *as φ* goes through (interface `possible`), so no drawn action is beyond
the kind's limits. A node's first actions are those that are known to be good for something: the default policy's, and
as φ. The default policy is that of the listed actions. Of the others one in two is a listed one.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from skd_sim.arrays import FloatArray

from skd_adversary.model.interfaces import (
    AS_PHI,
    FOLLOWS_PHI,
    draw_velocity,
    listed_action,
    listed_velocity,
    possible,
    sensible,
)
from skd_adversary.model.parts import template

ACTION_DIM: Final = 2
"""Of a drawn action: velocity to the East and to the North, m/s."""
SUFFIX: Final = "_drawn"
"""Of names of compositions."""
_LISTED = 0.5
"""Share of the tries that are of listed actions: full efforts, which nothing that is drawn uniformly comes up to."""
_TRIES = 8
"""Velocities that are drawn, at most, until one makes sense; after them as φ, or the default policy's."""


@template("possible")
def velocity(parameters: Any, state: FloatArray, action: FloatArray) -> tuple[float, float]:
    """Interface `velocity`, and `chosen`: what comes nearest to what was drawn."""
    return possible(parameters, state, action[0], action[1])


@template("listed_action", "listed_velocity")
def rollout_action(parameters: Any, state: FloatArray, action: FloatArray, rng: np.random.Generator) -> None:
    """Write the velocity of the listed action that the default policy takes; see `Pomdp`."""
    action[0], action[1] = listed_velocity(parameters, state, listed_action(parameters, state, rng))


@template("rollout_action", "listed_velocity", "draw_velocity", "sensible", "AS_PHI", "FOLLOWS_PHI")
def draw_action(
    parameters: Any, state: FloatArray, depth: int, tried: int, action: FloatArray, rng: np.random.Generator
) -> None:
    """Draw a velocity that makes sense; see `Pomdp`."""
    if tried == 0:
        rollout_action(parameters, state, action, rng)
        return
    if tried > 1 or not FOLLOWS_PHI:
        for _ in range(_TRIES):
            if rng.random() < _LISTED:
                vx, vy = listed_velocity(parameters, state, int(AS_PHI * rng.random()))
            else:
                vx, vy = draw_velocity(parameters, state, rng)
            if sensible(parameters, state, vx, vy):
                action[0], action[1] = vx, vy
                return
    if FOLLOWS_PHI:
        action[0], action[1] = listed_velocity(parameters, state, AS_PHI)
    else:
        rollout_action(parameters, state, action, rng)
