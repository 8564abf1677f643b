"""One step of a model of the planning benchmark, by itself."""

from __future__ import annotations

import numpy as np
from skd_adversary.pomdp.model import Pomdp


def step(model: Pomdp, state: list[float], action: int) -> tuple[float, bool, list[float]]:
    """Return reward, whether it ends there, and the next state; what is drawn is the same each time."""
    after = np.empty(model.state_dim)
    reward, terminal = model.step(model.parameters, np.array(state, float), action, after, np.random.default_rng(0))
    return reward, terminal, after.tolist()
