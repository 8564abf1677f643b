"""LightDark in one dimension: localise in the light, then stop at the origin.

As in POMCPOW's experiments (Sunberg and Kochenderfer 2018; `SimpleLightDark` of
`zsunberg/ContinuousPOMDPTreeSearchExperiments.jl`): integer positions in [−60, 60], start uniform over [−30, 30],
actions −10, −1, 0, +1, +10. A move costs 1 and stops at ±60. Action 0 ends the episode: +100 at the origin, −100
elsewhere. The observation is continuous, N(s, (|s − 10| + 10⁻⁴)²): exact at 10, the light. γ = 0.95.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from skd_adversary.planning.general.observed_values import with_observed_leaves
from skd_adversary.planning.pomdp import Pomdp
from skd_sim.arrays import FloatArray, IntArray
from skd_sim.kernels.compilation import kernel

MOVES: Final = (-10, -1, 0, 1, 10)
STOP: Final = 2  # index of 0 in MOVES
DISCOUNT: Final = 0.95


class LightDarkParameters(NamedTuple):
    """Geometry, rewards, and the default policy of each position (`values_by_the_light`)."""

    moves: FloatArray
    values: FloatArray
    by_light: IntArray
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
    """Go to the light, from there to the origin: first try of a new node."""
    return parameters.by_light[int(state[0] + parameters.radius)]


@kernel(inline=True)
def any_action(parameters: LightDarkParameters, state: FloatArray, rng: np.random.Generator) -> int:
    """Do anything: a default policy that knows nothing of the problem."""
    return int(5.0 * rng.random())


@kernel(inline=True)
def leaf_value(parameters: LightDarkParameters, state: FloatArray) -> float:
    """Return the value of going to the light and from there, where the position is known, to the origin.

    The value if the position were seen at once makes every delay look as if all were known after it.
    """
    return parameters.values[int(state[0] + parameters.radius)]


@kernel
def reinvigorate(
    parameters: LightDarkParameters, state: FloatArray, seen: FloatArray, redrawn: FloatArray, rng: np.random.Generator
) -> None:
    """Draw a position around what was seen, as blurred as it is there."""
    sigma = abs(seen[0] - parameters.light) + parameters.sharpest
    redrawn[0] = min(max(round(seen[0] + sigma * rng.standard_normal()), -parameters.radius), parameters.radius)


def values_by_the_light(radius: int, light: int) -> tuple[FloatArray, IntArray]:
    """Return value and action, from −radius to radius, of the fastest way to the light and from there to the origin."""
    positions = np.arange(-radius, radius + 1)
    moves = [i for i in range(len(MOVES)) if i != STOP]
    targets = np.stack([np.clip(positions + MOVES[i], -radius, radius) + radius for i in moves])

    def fastest(goal: int, value: float) -> tuple[FloatArray, IntArray]:
        values = np.full(len(positions), -1.0 / (1.0 - DISCOUNT))
        values[goal + radius] = value
        while True:
            q = -1.0 + DISCOUNT * values[targets]
            after = np.maximum(values, q.max(axis=0))
            if np.array_equal(after, values):
                return values, np.array(moves)[q.argmax(axis=0)]
            values = after

    home, way_home = fastest(0, 100.0)
    values, actions = fastest(light, home[light + radius])
    actions[light + radius] = way_home[light + radius]
    return values, actions


def light_dark() -> Pomdp:
    """Return LightDark."""
    return Pomdp(
        name="benchmark_light_dark",
        state_dim=1,
        observation_dim=1,
        action_count=len(MOVES),
        discount=DISCOUNT,
        parameters=LightDarkParameters(np.array(MOVES, float), *values_by_the_light(60, 10)),
        initial=initial,
        step=step,
        observe=observe,
        likelihood=likelihood,
        rollout_action=rollout_action,
        reinvigorate=reinvigorate,
        leaf_value=leaf_value,
    )


def light_dark_rollouts() -> Pomdp:
    """Return LightDark without leaf values: rollouts begin with the default policy."""
    return replace(light_dark(), leaf_value=None)


def light_dark_at_random() -> Pomdp:
    """Return LightDark without leaf values, and with a default policy that does anything."""
    return replace(light_dark_rollouts(), name="benchmark_light_dark_at_random", rollout_action=any_action)


def light_dark_observed() -> Pomdp:
    """Return LightDark with leaves worth what they would be if the position were seen, as in POMCPOW's experiments."""
    return with_observed_leaves(light_dark(), ((-60, 60),), samples=1)
