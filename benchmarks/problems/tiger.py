"""Tiger: listen, or open one of two doors (Kaelbling, Littman and Cassandra 1998, Artificial Intelligence 101).

The tiger is behind the left (state 0) or the right door (state 1), each with probability 1/2. Listening costs 1 and is
right with probability 0.85; the tiger's door costs 100, the other one is worth 10, and after either the tiger is put
behind a door anew and what is heard means nothing. γ = 0.95. The optimum from the even belief is 19.37.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from skd_adversary.pomdp.model import Pomdp
from skd_sim.kernels.compilation import kernel
from skd_sim.world.state import FloatArray

LISTEN, OPEN_LEFT, OPEN_RIGHT = range(3)
DISCOUNT: Final = 0.95
OPTIMUM: Final = 19.3714
"""Value of the even belief; any exact solver gives it."""


class TigerParameters(NamedTuple):
    """Probability to hear right, and the rewards."""

    accuracy: float = 0.85
    listen: float = -1.0
    wrong: float = -100.0
    right: float = 10.0


@kernel
def initial(parameters: TigerParameters, state: FloatArray, rng: np.random.Generator) -> None:
    """Put the tiger behind either door."""
    state[0] = 1.0 if rng.random() < 0.5 else 0.0


@kernel(inline=True)
def step(
    parameters: TigerParameters, state: FloatArray, action: int, after: FloatArray, rng: np.random.Generator
) -> tuple[float, bool]:
    """Listen, or open a door and begin anew."""
    if action == LISTEN:
        after[0] = state[0]
        return parameters.listen, False
    after[0] = 1.0 if rng.random() < 0.5 else 0.0
    return parameters.wrong if state[0] == action - 1 else parameters.right, False


@kernel(inline=True)
def observe(
    parameters: TigerParameters, state: FloatArray, action: int, heard: FloatArray, rng: np.random.Generator
) -> None:
    """Hear the tiger on one side."""
    correct = rng.random() < (parameters.accuracy if action == LISTEN else 0.5)
    heard[0] = state[0] if correct else 1.0 - state[0]


@kernel(inline=True)
def likelihood(parameters: TigerParameters, state: FloatArray, action: int, heard: FloatArray) -> float:
    """Return the probability of what was heard."""
    if action != LISTEN:
        return 0.5
    return parameters.accuracy if heard[0] == state[0] else 1.0 - parameters.accuracy


@kernel(inline=True)
def rollout_action(parameters: TigerParameters, state: FloatArray, rng: np.random.Generator) -> int:
    """Listen: the only action whose value does not depend on the state."""
    return LISTEN


@kernel
def reinvigorate(
    parameters: TigerParameters, state: FloatArray, heard: FloatArray, redrawn: FloatArray, rng: np.random.Generator
) -> None:
    """Put the tiger behind either door."""
    redrawn[0] = 1.0 if rng.random() < 0.5 else 0.0


def tiger() -> Pomdp:
    """Return Tiger."""
    return Pomdp(
        name="benchmark_tiger",
        state_dim=1,
        observation_dim=1,
        action_count=3,
        discount=DISCOUNT,
        parameters=TigerParameters(),
        initial=initial,
        step=step,
        observe=observe,
        likelihood=likelihood,
        rollout_action=rollout_action,
        reinvigorate=reinvigorate,
    )
