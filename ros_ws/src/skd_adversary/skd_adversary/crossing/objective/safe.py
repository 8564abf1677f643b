"""The safe POMDP 𝒫°: reach the destination as fast as possible without a collision.

Paper, section "Generating Safe Trajectories": the model of the kamikaze POMDP with another reward. The car that it is
played against need not be the one under test; here it is the most cautious basic car of the paper.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import runs_into

from skd_adversary.crossing.crossing import ADVERSARY_X, ADVERSARY_Y, within
from skd_adversary.crossing.interfaces import move, on_road, steer, velocity
from skd_adversary.crossing.parts import SEARCH, ObjectiveModel, template
from skd_adversary.crossing.road_user.pedestrian import EAST

REFERENCE_MULTIPLIER: Final = 1.15
"""C of the car that synthetic safe trajectories are generated with: the safest of the paper's nine."""

DISCOUNT: Final = 0.95
REWARDS: Final[Mapping[str, float]] = {
    "destination_reward": 100.0,
    "collision_reward": -200.0,
    "step_reward": -10.0,
}
"""The paper names no numbers. A collision costs two crossings; the step cost makes "as fast as possible" count, so that
the adversary gives way by a few decimetres rather than by metres."""


@template("velocity", "move", "on_road")
def step(
    parameters: Any,
    state: FloatArray,
    action: int,
    next_state: FloatArray,
    rng: np.random.Generator,
) -> tuple[float, bool]:
    """Generative step: (reward, terminal); ends at a collision, in an obstacle or at the destination."""
    p = parameters
    vx, vy = velocity(p, state, action)
    if move(p, state, vx, vy, next_state, rng) <= 1.0:
        return p.step_reward + p.collision_reward, True
    x, y = next_state[ADVERSARY_X], next_state[ADVERSARY_Y]
    if runs_into(p.obstacles, state[ADVERSARY_X], state[ADVERSARY_Y], x, y, p.core):
        return p.step_reward + p.collision_reward, True
    across, along = on_road(p, x, y)
    if within(p.arrival, across, along):
        return p.step_reward + p.destination_reward, True
    return p.step_reward, False


@template("steer")
def rollout_action(parameters: Any, state: FloatArray, rng: np.random.Generator) -> int:
    """Default policy: straight across."""
    return steer(parameters, state, EAST)


def parameters_of(scenario: Scenario, path: FloatArray) -> Mapping[str, float]:
    """Return the rewards."""
    return REWARDS


OBJECTIVE: Final = ObjectiveModel(
    "safe", DISCOUNT, replace(SEARCH, exploration=100.0), parameters_of, step=step, rollout_action=rollout_action
)
