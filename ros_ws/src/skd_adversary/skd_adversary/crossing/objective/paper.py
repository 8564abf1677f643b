"""The kamikaze POMDP 𝒫†: collide as fast as possible while staying near the safe trajectory φ.

Paper, section "Generating Kamikaze Trajectories": high reward at a collision, a penalty per step proportional to the
distance between the adversary's position and φ, discounted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.scenario.scenario import Scenario

from skd_adversary.crossing.crossing import ADVERSARY_X, ADVERSARY_Y, CAR_S, leads_nowhere
from skd_adversary.crossing.interfaces import move, on_road, steer, velocity
from skd_adversary.crossing.parts import SEARCH, ObjectiveModel, template
from skd_adversary.crossing.road_user.pedestrian import EAST, SOUTH, STAY
from skd_adversary.crossing.safe_path import polyline_distance, polyline_segments

DISCOUNT: Final = 0.95
REWARDS: Final[Mapping[str, float]] = {"collision_reward": 100.0, "distance_weight": 1.0}
"""The paper names no numbers. One step's delay costs (1 − γ)·100 = 5, as much as a step spent 5 m away from φ, so
"as fast as possible" and "close to φ" both count at the scale of a lane. The same for every car and every C."""


@template("velocity", "move", "on_road")
def step(
    parameters: Any,
    state: FloatArray,
    action: int,
    next_state: FloatArray,
    rng: np.random.Generator,
) -> tuple[float, bool]:
    """Generative step: (reward, terminal).

    It ends at a collision, in what stands, or where the car cannot be met any more.
    """
    p = parameters
    vx, vy = velocity(p, state, action)
    hit = move(p, state, vx, vy, next_state, rng) <= 1.0
    distance = polyline_distance(next_state[ADVERSARY_X], next_state[ADVERSARY_Y], p.segments)
    reward = -p.distance_weight * distance
    if hit:
        return reward + p.collision_reward, True
    x, y = next_state[ADVERSARY_X], next_state[ADVERSARY_Y]
    across, along = on_road(p, x, y)
    return reward, leads_nowhere(p, across, along, state[ADVERSARY_X], state[ADVERSARY_Y], x, y)


@template("on_road", "steer")
def rollout_action(parameters: Any, state: FloatArray, rng: np.random.Generator) -> int:
    """Default policy: into the car's path, then wait for the car or walk towards it; into its side if it is there."""
    p = parameters
    across, along = on_road(p, state[ADVERSARY_X], state[ADVERSARY_Y])
    alongside = state[CAR_S] + p.front >= along
    if p.crossing * across < -0.5 * p.half_width or alongside:
        return steer(p, state, EAST)
    return steer(p, state, SOUTH if rng.random() < 0.5 else STAY)


def parameters_of(scenario: Scenario, path: FloatArray) -> Mapping[str, Any]:
    """Return the rewards, and φ as segments."""
    return {**REWARDS, "segments": polyline_segments(np.asarray(path, dtype=np.float64))}


OBJECTIVE: Final = ObjectiveModel(
    "paper", DISCOUNT, replace(SEARCH, exploration=30.0), parameters_of, step=step, rollout_action=rollout_action
)
