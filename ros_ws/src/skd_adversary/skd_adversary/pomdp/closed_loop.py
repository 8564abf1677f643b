"""An episode in closed loop: decide, act, observe, update the belief."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from skd_sim.arrays import FloatArray

from skd_adversary.pomdp.belief import ParticleBelief
from skd_adversary.pomdp.pomdp import Pomdp


class DecisionMaker(Protocol):
    """Whoever decides: a planner, or a policy in its place."""

    def plan(self, belief: ParticleBelief) -> int:
        """Return an action."""

    def advance(self, action: int, observation: FloatArray) -> None:
        """Be told what was done and what was observed after it."""


@dataclass(frozen=True)
class Played:
    """An episode that was played.

    Attributes:
        value: discounted return of the episode.
        actions: the actions that were taken, in order.
        ended: whether the model ended the episode, and not the limit of moves.
    """

    value: float
    actions: tuple[int, ...]
    ended: bool


def play(
    model: Pomdp, belief: ParticleBelief, planner: DecisionMaker, rng: np.random.Generator, *, moves: int = 1000
) -> Played:
    """Play an episode.

    Args:
        model: the world; the planner may plan with another model of the same states, such as one with leaf values.
        belief: belief at the beginning; it is updated in the episode.
        planner: chooses the actions.
        rng: generator of what happens in the world.
        moves: greatest number of moves.

    Raises:
        ValueError: the belief is about states of another length.
    """
    if belief.particles.shape[1] != model.state_dim:
        raise ValueError(
            f"{model.name} has states of {model.state_dim} numbers, and the belief's have {belief.particles.shape[1]}"
        )
    state, after, seen = np.empty(model.state_dim), np.empty(model.state_dim), np.empty(model.observation_dim)
    model.initial(model.parameters, state, rng)
    value, discount, ended = 0.0, 1.0, False
    actions: list[int] = []
    while not ended and len(actions) < moves:
        action = planner.plan(belief)
        actions.append(action)
        reward, ended = model.step(model.parameters, state, action, after, rng)
        value, discount, state[:] = value + discount * reward, discount * model.discount, after
        if not ended:
            model.observe(model.parameters, state, action, seen, rng)
            belief.predict(action)
            belief.correct(action, seen)
            planner.advance(action, seen)
    return Played(value, tuple(actions), bool(ended))
