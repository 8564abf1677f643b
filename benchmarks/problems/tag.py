"""Tag: chase an opponent that one does not see over 29 cells (Pineau, Gordon and Thrun 2003, IJCAI).

As in DESPOT's C++ (`AdaCompNUS/despot`, examples/cpp_models/tag): both start anywhere, independently and uniformly, and
the robot's own cell is part of the state that it learns with its first observation. It observes its cell, or that the
opponent is in the same cell. A move costs 1, a tag is worth 10 and ends the episode, tagging elsewhere costs 10.
γ = 0.95. A point-based solver's policy is worth −6.03 ± 0.04 (SARSOP; Kurniawati, Hsu and Lee 2008).
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from skd_adversary.pomdp import FloatArray, Pomdp
from skd_sim.compilation import kernel

from problems.pursuit import (
    DISCOUNT,
    STEP_REWARD,
    TAG,
    TAG_REWARD,
    IntArray,
    fully_observable_solution,
    opponent_moves,
    robot_moves,
)

CELLS: Final = (
    *((x, 0) for x in range(10)),
    *((x, 1) for x in range(10)),
    *((x, y) for y in range(2, 5) for x in range(5, 8)),
)
"""Two rows of ten, and three of three above them (the floor of the paper)."""
ROBOT, OPPONENT, GUESS = range(3)
"""State: two cells, and where the default policy looks for the opponent; the last has no part in the problem itself."""


class TagParameters(NamedTuple):
    """Tables of `problems.pursuit`; `chase` is the best action if the opponent were seen."""

    robot_moves: IntArray
    opponent_moves: IntArray
    chase: IntArray


@kernel
def initial(parameters: TagParameters, state: FloatArray, rng: np.random.Generator) -> None:
    """Put both anywhere."""
    count = parameters.robot_moves.shape[0]
    state[ROBOT] = int(count * rng.random())
    state[OPPONENT] = int(count * rng.random())
    state[GUESS] = int(count * rng.random())


@kernel(inline=True)
def step(
    parameters: TagParameters, state: FloatArray, action: int, after: FloatArray, rng: np.random.Generator
) -> tuple[float, bool]:
    """Move or tag; the opponent flees from where the robot was."""
    robot, opponent = int(state[ROBOT]), int(state[OPPONENT])
    moved = parameters.robot_moves[robot, action]
    after[ROBOT] = moved
    if action == TAG and robot == opponent:
        after[OPPONENT] = opponent
        after[GUESS] = opponent
        return TAG_REWARD, True
    opponent = parameters.opponent_moves[robot, opponent, int(5.0 * rng.random())]
    after[OPPONENT] = opponent
    # The guess flees like an opponent; it is right where the opponent is seen, and drawn anew where it is not.
    guess = parameters.opponent_moves[robot, int(state[GUESS]), int(5.0 * rng.random())]
    if opponent == moved:
        guess = opponent
    elif guess == moved:
        guess = int(parameters.robot_moves.shape[0] * rng.random())
    after[GUESS] = guess
    return -TAG_REWARD if action == TAG else STEP_REWARD, False


@kernel(inline=True)
def observe(
    parameters: TagParameters, state: FloatArray, action: int, seen: FloatArray, rng: np.random.Generator
) -> None:
    """See the robot's cell, or −1: the opponent is here."""
    seen[0] = -1.0 if state[ROBOT] == state[OPPONENT] else state[ROBOT]


@kernel(inline=True)
def likelihood(parameters: TagParameters, state: FloatArray, action: int, seen: FloatArray) -> float:
    """Return 1 if the state looks like that, else 0."""
    return 1.0 if seen[0] == (-1.0 if state[ROBOT] == state[OPPONENT] else state[ROBOT]) else 0.0


@kernel(inline=True)
def rollout_action(parameters: TagParameters, state: FloatArray, rng: np.random.Generator) -> int:
    """Tag where the opponent is seen, else chase the guess, which knows no more than what was observed."""
    robot, opponent = int(state[ROBOT]), int(state[OPPONENT])
    if robot == opponent:
        return TAG
    action = parameters.chase[robot, int(state[GUESS])]
    return int(4.0 * rng.random()) if action == TAG else action


@kernel(inline=True)
def legal(parameters: TagParameters, state: FloatArray, action: int) -> bool:
    """Return whether an action makes sense: tagging does where the opponent is seen, and elsewhere never."""
    return action != TAG or state[ROBOT] == state[OPPONENT]


@kernel
def reinvigorate(
    parameters: TagParameters, state: FloatArray, seen: FloatArray, redrawn: FloatArray, rng: np.random.Generator
) -> None:
    """Put the opponent anywhere that agrees with the observation; the robot's cell is known."""
    count = parameters.robot_moves.shape[0]
    redrawn[ROBOT] = state[ROBOT] if seen[0] < 0.0 else seen[0]
    redrawn[OPPONENT] = redrawn[ROBOT] if seen[0] < 0.0 else int(count * rng.random())
    redrawn[GUESS] = redrawn[OPPONENT] if seen[0] < 0.0 else int(count * rng.random())


def tag() -> Pomdp:
    """Return Tag."""
    robot, opponent = robot_moves(CELLS), opponent_moves(CELLS)
    return Pomdp(
        name="benchmark_tag",
        state_dim=3,
        observation_dim=1,
        action_count=5,
        discount=DISCOUNT,
        parameters=TagParameters(robot, opponent, fully_observable_solution(robot, opponent)[1]),
        initial=initial,
        step=step,
        observe=observe,
        likelihood=likelihood,
        rollout_action=rollout_action,
        reinvigorate=reinvigorate,
    )
