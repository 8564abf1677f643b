"""Small POMDPs whose answers are known, for the tests of belief and planner; and episodes of the crossing.

Compiled functions belong to a module: the planner's cache knows them by it.
"""

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from problems import tiger as benchmark
from problems.tiger import LISTEN, TigerParameters
from skd_adversary.crossing.interfaces import CAR_S, CAR_SPEED
from skd_adversary.pomdp.model import Pomdp
from skd_sim.kernels.compilation import kernel
from skd_sim.world.contact import first_contact
from skd_sim.world.state import FloatArray


@kernel
def gaussian_observe(parameters, state, action, heard, rng):
    heard[0] = (2.0 * state[0] - 1.0 if action == LISTEN else 0.0) + rng.standard_normal()


@kernel
def gaussian_likelihood(parameters: TigerParameters, state: FloatArray, action: int, heard: FloatArray) -> float:
    error = heard[0] - (2.0 * state[0] - 1.0 if action == LISTEN else 0.0)
    return math.exp(-0.5 * error * error)


def tiger(*, gaussian: bool = False, **parameters: float) -> Pomdp:
    model = replace(benchmark.tiger(), parameters=TigerParameters(**parameters))
    if not gaussian:
        return model
    return replace(model, name="test_tiger_gaussian", observe=gaussian_observe, likelihood=gaussian_likelihood)


class RingParameters(NamedTuple):
    cells: int = 12
    forward: float = 0.7  # probability to go on by `action` cells, else it stays
    stop: float = 0.5  # probability that arriving in cell 0 ends the episode
    sigma: float = 1.5


@kernel
def ring_initial(parameters: RingParameters, state: FloatArray, rng: np.random.Generator) -> None:
    state[0] = math.floor(parameters.cells * rng.random())


@kernel
def ring_step(parameters, state, action, after, rng):
    after[0] = state[0]
    if rng.random() < parameters.forward:
        after[0] = (state[0] + action) % parameters.cells
    return 0.0, after[0] == 0.0 and rng.random() < parameters.stop


@kernel
def ring_observe(parameters, state, action, seen, rng):
    seen[0] = state[0] + parameters.sigma * rng.standard_normal()


@kernel
def ring_likelihood(parameters: RingParameters, state: FloatArray, action: int, seen: FloatArray) -> float:
    error = (seen[0] - state[0]) / parameters.sigma
    return math.exp(-0.5 * error * error)


@kernel
def ring_rollout(parameters: RingParameters, state: FloatArray, rng: np.random.Generator) -> int:
    return 1


@kernel
def ring_reinvigorate(parameters, state, seen, redrawn, rng):
    redrawn[0] = min(max(round(seen[0]), 0), parameters.cells - 1)


def ring(**parameters: Any) -> Pomdp:
    return Pomdp(
        name="test_ring",
        state_dim=1,
        observation_dim=1,
        action_count=4,
        discount=0.9,
        parameters=RingParameters(**parameters),
        initial=ring_initial,
        step=ring_step,
        observe=ring_observe,
        likelihood=ring_likelihood,
        rollout_action=ring_rollout,
        reinvigorate=ring_reinvigorate,
    )


class Walk(NamedTuple):
    """How an episode of a model of the crossing went; contact is a share of the last tick, infinite without one."""

    positions: FloatArray
    earned: float
    terminal: bool
    contact: float
    impact: float  # m/s


def played(model: Pomdp, rng: np.random.Generator, actions: int, *, by_policy: bool) -> Walk:
    """Play a model by its default policy or by random actions; the path ends where road user and car touch."""
    p, state, after = model.parameters, np.empty(model.state_dim), np.empty(model.state_dim)
    model.initial(p, state, rng)
    walked, earned, terminal, share, impact = [state[:2].copy()], 0.0, False, math.inf, math.nan
    for _ in range(40):
        action = model.rollout_action(p, state, rng) if by_policy else int(rng.integers(actions))
        reward, terminal = model.step(p, state, action, after, rng)
        earned += reward
        x, y = state[:2]
        seen, seen_after = (y - state[CAR_S], -x), (after[1] - after[CAR_S], -after[0])
        share = first_contact(seen, seen_after, (p.front, p.rear, p.half_width), p.radius)
        impact = state[CAR_SPEED] + min(1.0, share) * (after[CAR_SPEED] - state[CAR_SPEED])
        walked.append(state[:2] + min(1.0, share) * (after[:2] - state[:2]))
        if terminal:
            break
        state, after = after, state
    return Walk(np.array(walked), earned, terminal, share, impact)
