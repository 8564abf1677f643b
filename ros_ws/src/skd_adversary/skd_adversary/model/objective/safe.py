"""The safe POMDP 𝒫°: reach the destination as fast as possible without a collision.

Paper, section "Generating Safe Trajectories": the model of the kamikaze POMDP with another reward. The car that it is
played against need not be the one under test; here it is the most cautious basic car of the paper.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from skd_sim.compilation import kernel
from skd_sim.scenario import Scenario

from skd_adversary.model import crossing
from skd_adversary.model.car.basic import CarModel
from skd_adversary.model.crossing import EAST, PEDESTRIAN_X, CrossingParameters
from skd_adversary.planning.pomdp import FloatArray, Pomdp

REFERENCE_MULTIPLIER: Final = 1.15
"""C of the car that synthetic safe trajectories are generated with: the safest of the paper's nine."""

DISCOUNT: Final = 0.95
REWARDS: Final[Mapping[str, float]] = {
    "destination_reward": 100.0,
    "collision_reward": -200.0,
    "step_reward": -10.0,
}
"""The paper names no numbers. A collision costs two crossings; the step cost makes "as fast as possible" count, so that
the pedestrian gives way by a few decimetres rather than by metres."""


@kernel(inline=True)
def step(
    parameters: CrossingParameters,
    state: FloatArray,
    action: int,
    next_state: FloatArray,
    rng: np.random.Generator,
) -> tuple[float, bool]:
    """Generative step: (reward, terminal); ends at a collision or at the destination."""
    p = parameters
    if crossing.transition(p, state, action, next_state, rng) <= 1.0:
        return p.step_reward + p.collision_reward, True
    if next_state[PEDESTRIAN_X] >= p.destination_x:
        return p.step_reward + p.destination_reward, True
    return p.step_reward, False


@kernel(inline=True)
def rollout_action(parameters: CrossingParameters, state: FloatArray, rng: np.random.Generator) -> int:
    """Default policy: straight across."""
    return EAST


def safe_pomdp(scenario: Scenario, car_model: CarModel, *, start: tuple[float, float], gap: float) -> Pomdp:
    """Return 𝒫° for a scenario.

    Args:
        scenario: fixed description of the test.
        car_model: what the adversary thinks of the car.
        start: the pedestrian's start (x, y), m.
        gap: front bumper to the crossing line before the episode's draw, m.
    """
    parameters = crossing.crossing_parameters(
        scenario, car_model, start=start, gap=gap, rewards=REWARDS, path=np.array([start])
    )
    return crossing.crossing_pomdp(
        "safe", parameters, car_model, discount=DISCOUNT, step=step, rollout_action=rollout_action
    )
