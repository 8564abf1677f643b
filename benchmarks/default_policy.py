"""A model's default policy in a planner's place: what planning has to be better than."""

from __future__ import annotations

import numpy as np
from skd_adversary.planning.belief import ParticleBelief
from skd_adversary.planning.options import PlannerOptions
from skd_adversary.planning.pomdp import Pomdp
from skd_sim.arrays import FloatArray


class DefaultPolicy:
    """Takes the default policy's action in a state that is drawn from the belief.

    A policy that goes by what was seen alone, which every particle holds, is played as it is.
    """

    def __init__(self, model: Pomdp, _options: PlannerOptions, rng: np.random.Generator) -> None:
        """Prepare for `model`; all randomness comes from `rng`."""
        self._model = model
        self._rng = rng

    def plan(self, belief: ParticleBelief) -> int:
        """Return the action."""
        state = belief.particles[self._rng.choice(len(belief.weights), p=belief.weights)]
        return int(self._model.rollout_action(self._model.parameters, state, self._rng))

    def advance(self, action: int, observation: FloatArray) -> None:
        """Nothing is kept."""
