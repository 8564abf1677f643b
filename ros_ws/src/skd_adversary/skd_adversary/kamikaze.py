"""The kamikaze POMDP 𝒫†: collide as fast as possible while staying near the safe trajectory φ.

Paper, section "Generating Kamikaze Trajectories": high reward at a collision, a penalty per step proportional to the
distance between the adversary's position and φ, discounted.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from skd_sim.compilation import kernel
from skd_sim.scenario import Scenario

from skd_adversary import crossing
from skd_adversary.car_model import CarModel
from skd_adversary.crossing import CAR_Y, EAST, PEDESTRIAN_X, PEDESTRIAN_Y, SOUTH, STAY, CrossingParameters
from skd_adversary.planning.pomdp import FloatArray, Pomdp

DISCOUNT: Final = 0.95
REWARDS: Final[Mapping[str, float]] = {"collision_reward": 100.0, "distance_weight": 1.0}
"""The paper names no numbers. One step's delay costs (1 − γ)·100 = 5, as much as a step spent 5 m away from φ, so
"as fast as possible" and "close to φ" both count at the scale of a lane. The same for every car and every C."""


@kernel(inline=True)
def step(
    parameters: CrossingParameters,
    state: FloatArray,
    action: int,
    next_state: FloatArray,
    rng: np.random.Generator,
) -> tuple[float, bool]:
    """Generative step: (reward, terminal); ends at a collision, or beyond the car's path: no action leads back."""
    p = parameters
    hit = crossing.transition(p, state, action, next_state, rng) <= 1.0
    distance = crossing.polyline_distance(next_state[PEDESTRIAN_X], next_state[PEDESTRIAN_Y], p.segments)
    reward = p.step_reward - p.distance_weight * distance
    if hit:
        return reward + p.collision_reward, True
    return reward, next_state[PEDESTRIAN_X] > p.half_width + p.radius


@kernel(inline=True)
def rollout_action(parameters: CrossingParameters, state: FloatArray, rng: np.random.Generator) -> int:
    """Default policy: into the car's path, then wait for the car or walk towards it; into its side if it is there."""
    p = parameters
    x = state[PEDESTRIAN_X]
    alongside = state[CAR_Y] + p.front >= state[PEDESTRIAN_Y]
    if x < -0.5 * p.half_width or alongside:
        return EAST
    return SOUTH if rng.random() < 0.5 else STAY


def kamikaze_pomdp(
    scenario: Scenario,
    car_model: CarModel,
    *,
    start: tuple[float, float],
    gap: float,
    path: FloatArray,
    maximum_distance: float | None = None,
) -> Pomdp:
    """Return 𝒫† for one safe trajectory.

    Args:
        scenario: fixed description of the test.
        car_model: what the adversary thinks of the car.
        start: the pedestrian's start (x, y), m: the first point of φ.
        gap: front bumper to the crossing line before the episode's draw, m.
        path: φ, n × 2, m.
        maximum_distance: of no matter to this plan, which may go as far as it likes.
    """
    parameters = crossing.crossing_parameters(scenario, car_model, start=start, gap=gap, rewards=REWARDS, path=path)
    return crossing.crossing_pomdp(
        "kamikaze", parameters, car_model, discount=DISCOUNT, step=step, rollout_action=rollout_action
    )
