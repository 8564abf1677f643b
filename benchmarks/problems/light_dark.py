"""LightDark in one dimension: localise in the light, then stop at the origin.

As in POMCPOW's experiments (Sunberg and Kochenderfer 2018; `SimpleLightDark` of
`zsunberg/ContinuousPOMDPTreeSearchExperiments.jl`): integer positions in [−60, 60], start uniform over [−30, 30],
actions −10, −1, 0, +1, +10. A move costs 1 and stops at ±60. Action 0 ends the episode: +100 at the origin, −100
elsewhere. The observation is continuous, N(s, (|s − 10| + 10⁻⁴)²): exact at 10, the light. γ = 0.95.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from skd_adversary.pomdp import FloatArray, Pomdp
from skd_sim.compilation import kernel

MOVES: Final = (-10, -1, 0, 1, 10)
STOP: Final = 2  # index of 0 in MOVES
DISCOUNT: Final = 0.95


class LightDarkParameters(NamedTuple):
    """Geometry, rewards and the values of the positions if they were seen (`fully_observable_values`)."""

    moves: FloatArray
    values: FloatArray
    radius: float = 60.0
    start_radius: float = 30.0
    light: float = 10.0
    sharpest: float = 1e-4
    correct: float = 100.0
    incorrect: float = -100.0
    move: float = -1.0


@kernel
def initial(parameters: LightDarkParameters, state: FloatArray, rng: np.random.Generator) -> None:
    """Start at an integer in [−30, 30]."""
    state[0] = math.floor((2.0 * parameters.start_radius + 1.0) * rng.random()) - parameters.start_radius


@kernel(inline=True)
def step(
    parameters: LightDarkParameters, state: FloatArray, action: int, after: FloatArray, rng: np.random.Generator
) -> tuple[float, bool]:
    """Move, or stop and be judged."""
    if action == STOP:
        after[0] = state[0]
        return parameters.correct if state[0] == 0.0 else parameters.incorrect, True
    after[0] = min(max(state[0] + parameters.moves[action], -parameters.radius), parameters.radius)
    return parameters.move, False


@kernel(inline=True)
def observe(
    parameters: LightDarkParameters, state: FloatArray, action: int, seen: FloatArray, rng: np.random.Generator
) -> None:
    """See the position with a noise that grows with the distance to the light."""
    seen[0] = state[0] + (abs(state[0] - parameters.light) + parameters.sharpest) * rng.standard_normal()


@kernel(inline=True)
def likelihood(parameters: LightDarkParameters, state: FloatArray, action: int, seen: FloatArray) -> float:
    """Return the density times √(2π)."""
    sigma = abs(state[0] - parameters.light) + parameters.sharpest
    error = (seen[0] - state[0]) / sigma
    return math.exp(-0.5 * error * error) / sigma


@kernel(inline=True)
def rollout_action(parameters: LightDarkParameters, state: FloatArray, rng: np.random.Generator) -> int:
    """Go to the origin and stop there, as if the position were seen."""
    x = state[0]
    if x == 0.0:
        return STOP
    size = 10.0 if abs(x) > 5.0 else 1.0
    towards = -size if x > 0.0 else size
    for action in range(parameters.moves.shape[0]):
        if parameters.moves[action] == towards:
            return action
    return STOP


@kernel(inline=True)
def leaf_value(parameters: LightDarkParameters, state: FloatArray) -> float:
    """Return the value if the position were seen."""
    return parameters.values[int(state[0] + parameters.radius)]


@kernel
def reinvigorate(
    parameters: LightDarkParameters, state: FloatArray, seen: FloatArray, redrawn: FloatArray, rng: np.random.Generator
) -> None:
    """Draw a position around what was seen, as blurred as it is there."""
    sigma = abs(seen[0] - parameters.light) + parameters.sharpest
    redrawn[0] = min(max(round(seen[0] + sigma * rng.standard_normal()), -parameters.radius), parameters.radius)


def fully_observable_values(radius: int) -> FloatArray:
    """Return the optimal value at −radius … radius when the position is seen: 0.95^k·100 less the cost of k moves."""
    positions = np.arange(-radius, radius + 1)
    values = np.where(positions == 0, 100.0, -100.0)
    while True:
        moved = [np.clip(positions + move, -radius, radius) + radius for move in MOVES if move != 0]
        after = np.maximum(values, np.max([-1.0 + DISCOUNT * values[target] for target in moved], axis=0))
        if np.array_equal(after, values):
            return values
        values = after


def light_dark() -> Pomdp:
    """Return LightDark."""
    return Pomdp(
        name="benchmark_light_dark",
        state_dim=1,
        observation_dim=1,
        action_count=len(MOVES),
        discount=DISCOUNT,
        parameters=LightDarkParameters(np.array(MOVES, float), fully_observable_values(60)),
        initial=initial,
        step=step,
        observe=observe,
        likelihood=likelihood,
        rollout_action=rollout_action,
        reinvigorate=reinvigorate,
    )
