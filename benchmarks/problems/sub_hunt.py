"""SubHunt: find a submarine that crosses a bay, and destroy it before it is gone (Sunberg and Kochenderfer 2018).

Rules of `zsunberg/SubHunt.jl`, as POMCPOW's experiments used it. Two submarines on 20 × 20 cells, 1 … 20. The target
starts anywhere along one edge and makes for the opposite one: two cells ahead with probability 1/2, else one ahead and
one to the left or the right. Ours starts at (10, 10) and goes three cells North, East, South or West, or pings, or
engages. To engage within 2 cells of the target kills it, with probability 0.6 only if it is aware of us; a ping makes
it so for good. A kill is worth 100, all else nothing. γ = 0.99.

Eight beams of 45° each give a range. Passive sonar (with all but the ping) says N(3, 5²) in every beam, but
N(distance, 0.5²) in the target's within 3 cells; the ping says N(20, 0.5²), and N(distance, 0.5²) in the target's. The
episode ends with a kill, or when the target has reached its edge.
"""

from __future__ import annotations

import functools
import math
from typing import Final, NamedTuple

import numpy as np
from observed_values import with_observed_leaves
from skd_adversary.pomdp.model import Pomdp
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel

NORTH, EAST, SOUTH, WEST, PING, ENGAGE = range(6)
OWN_X, OWN_Y, X, Y, GOAL, AWARE = range(6)
DISCOUNT: Final = 0.99
STATES: Final = ((1, 20), (1, 20), (1, 20), (1, 20), (0, 3), (0, 1))
"""Lowest and highest value of each number of a state."""
_BEAMS = 8


class SubHuntParameters(NamedTuple):
    """Cells, probabilities and standard deviations; see the module."""

    size: float = 20.0
    speed: float = 3.0
    kill_radius: float = 2.0
    kill_if_aware: float = 0.6
    kill: float = 100.0
    passive_radius: float = 3.0
    passive_sigma: float = 5.0
    sigma: float = 0.5


@kernel(inline=True)
def _way(direction: int) -> tuple[int, int]:
    return (direction == EAST) - (direction == WEST), (direction == NORTH) - (direction == SOUTH)


@kernel(inline=True)
def _range(state: FloatArray) -> float:
    return math.hypot(state[X] - state[OWN_X], state[Y] - state[OWN_Y])


@kernel
def initial(p: SubHuntParameters, state: FloatArray, rng: np.random.Generator) -> None:
    """Put the target somewhere along an edge, and us in the middle."""
    goal = int(4.0 * rng.random())
    along = 1.0 + math.floor(p.size * rng.random())
    far = 1.0 if goal in (NORTH, EAST) else p.size
    state[OWN_X] = state[OWN_Y] = round(p.size / 2.0)
    state[X], state[Y] = (along, far) if goal in (NORTH, SOUTH) else (far, along)
    state[GOAL], state[AWARE] = goal, 0.0


@kernel(inline=True)
def step(
    p: SubHuntParameters, state: FloatArray, action: int, after: FloatArray, rng: np.random.Generator
) -> tuple[float, bool]:
    """Move both, or engage."""
    for k in range(state.shape[0]):
        after[k] = state[k]
    if action == PING:
        after[AWARE] = 1.0
    elif action != ENGAGE:
        east, north = _way(action)
        after[OWN_X] = min(max(state[OWN_X] + p.speed * east, 1.0), p.size)
        after[OWN_Y] = min(max(state[OWN_Y] + p.speed * north, 1.0), p.size)
    elif _range(state) <= p.kill_radius and (state[AWARE] == 0.0 or rng.random() < p.kill_if_aware):
        after[X], after[Y] = after[OWN_X], after[OWN_Y]  # a published planner observes what is sunk: at distance 0
        return p.kill, True
    goal = int(state[GOAL])
    draw = rng.random()
    ahead, aside = _way(goal), _way(goal if draw < 0.5 else (goal + 3) % 4 if draw < 0.75 else (goal + 1) % 4)
    after[X] = min(max(state[X] + ahead[0] + aside[0], 1.0), p.size)
    after[Y] = min(max(state[Y] + ahead[1] + aside[1], 1.0), p.size)
    along = after[Y] if goal in (NORTH, SOUTH) else after[X]
    return 0.0, along == (p.size if goal in (NORTH, EAST) else 1.0)


@kernel(inline=True)
def _readings(p: SubHuntParameters, state: FloatArray, action: int) -> tuple[int, float, float, float]:
    """Return (beam that sees the target or −1, its mean, mean of the others, their σ)."""
    distance = _range(state)
    beam = -1
    if action == PING or distance <= p.passive_radius:
        angle = math.atan2(state[Y] - state[OWN_Y], state[X] - state[OWN_X])
        angle += 2.0 * math.pi if angle <= 0.0 else 0.0
        beam = min(max(math.ceil(_BEAMS * angle / (2.0 * math.pi)), 1), _BEAMS) - 1
    return (beam, distance, p.size, p.sigma) if action == PING else (beam, distance, p.passive_radius, p.passive_sigma)


@kernel(inline=True)
def observe(p: SubHuntParameters, state: FloatArray, action: int, seen: FloatArray, rng: np.random.Generator) -> None:
    """Read the range in each beam."""
    beam, distance, mean, sigma = _readings(p, state, action)
    for k in range(_BEAMS):
        seen[k] = distance + p.sigma * rng.standard_normal() if k == beam else mean + sigma * rng.standard_normal()


@kernel(inline=True)
def likelihood(p: SubHuntParameters, state: FloatArray, action: int, seen: FloatArray) -> float:
    """Return the density, up to what all states have in common."""
    beam, distance, mean, sigma = _readings(p, state, action)
    squares = 0.0
    for k in range(_BEAMS):
        error = (seen[k] - distance) / p.sigma if k == beam else (seen[k] - mean) / sigma
        squares += error * error
    return math.exp(-0.5 * squares) / (p.sigma if beam >= 0 else sigma)


@kernel(inline=True)
def rollout_action(p: SubHuntParameters, state: FloatArray, rng: np.random.Generator) -> int:
    """Go towards the target, and engage it within range."""
    dx, dy = state[X] - state[OWN_X], state[Y] - state[OWN_Y]
    if _range(state) <= p.kill_radius:
        return ENGAGE
    if abs(dx) > abs(dy):
        return EAST if dx > 0.0 else WEST
    return NORTH if dy > 0.0 else SOUTH


@kernel(inline=True)
def any_action(p: SubHuntParameters, state: FloatArray, rng: np.random.Generator) -> int:
    """Do anything: a default policy that knows nothing of the problem."""
    return int(6.0 * rng.random())


@kernel
def reinvigorate(
    p: SubHuntParameters, state: FloatArray, seen: FloatArray, redrawn: FloatArray, rng: np.random.Generator
) -> None:
    """Keep what is ours; the target may be anywhere."""
    for k in (OWN_X, OWN_Y, AWARE):
        redrawn[k] = state[k]
    redrawn[X], redrawn[Y] = 1.0 + math.floor(p.size * rng.random()), 1.0 + math.floor(p.size * rng.random())
    redrawn[GOAL] = math.floor(4.0 * rng.random())


def sub_hunt() -> Pomdp:
    """Return SubHunt."""
    return Pomdp(
        name="benchmark_sub_hunt",
        state_dim=6,
        observation_dim=_BEAMS,
        action_count=6,
        discount=DISCOUNT,
        parameters=SubHuntParameters(),
        initial=initial,
        step=step,
        observe=observe,
        likelihood=likelihood,
        rollout_action=rollout_action,
        reinvigorate=reinvigorate,
    )


@functools.cache
def sub_hunt_with_leaves() -> Pomdp:
    """Return SubHunt with the value of the fully observed problem at its leaves."""
    return with_observed_leaves(sub_hunt(), STATES)
