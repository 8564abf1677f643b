"""Tag: chase an opponent that one does not see over 29 cells (Pineau, Gordon and Thrun 2003, IJCAI).

As in DESPOT's C++ (`AdaCompNUS/despot`, examples/cpp_models/tag): both start anywhere, independently and uniformly, and
the robot's own cell is part of the state that it learns with its first observation. It observes its cell, or that the
opponent is in the same cell. A move costs 1, a tag is worth 10 and ends the episode, tagging elsewhere costs 10.
γ = 0.95. A point-based solver's policy is worth −6.03 ± 0.04 (SARSOP; Kurniawati, Hsu and Lee 2008).
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from skd_adversary.planning.pomdp import Pomdp
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel

from problems.pursuit import (
    DISCOUNT,
    PATIENCE,
    STEP_REWARD,
    TAG,
    TAG_REWARD,
    IntArray,
    distances,
    fully_observable_solution,
    opponent_moves,
    predict,
    remember,
    robot_moves,
    search_move,
    search_value,
)

CELLS: Final = (
    *((x, 0) for x in range(10)),
    *((x, 1) for x in range(10)),
    *((x, y) for y in range(2, 5) for x in range(5, 8)),
)
"""Two rows of ten, and three of three above them (the floor of the paper)."""
ROBOT, OPPONENT, CHANCES = range(3)
"""State: two cells; from CHANCES on P(the opponent is in cell i | what was seen), which has no part in the problem."""


class TagParameters(NamedTuple):
    """Tables of `problems.pursuit`, PATIENCE^distance cell × cell, and memory for `leaf_value`.

    `chase` is the best action if the opponent were seen.
    """

    robot_moves: IntArray
    opponent_moves: IntArray
    chase: IntArray
    nearness: FloatArray
    scratch: FloatArray  # 2 × cells


@kernel
def initial(parameters: TagParameters, state: FloatArray, rng: np.random.Generator) -> None:
    """Put both anywhere."""
    count = parameters.robot_moves.shape[0]
    state[ROBOT] = int(count * rng.random())
    state[OPPONENT] = int(count * rng.random())
    state[CHANCES:] = 1.0 / count


@kernel(inline=True)
def step_alone(
    parameters: TagParameters, state: FloatArray, action: int, after: FloatArray, rng: np.random.Generator
) -> tuple[float, bool]:
    """Move or tag; the opponent flees from where the robot was."""
    robot, opponent = int(state[ROBOT]), int(state[OPPONENT])
    after[ROBOT] = parameters.robot_moves[robot, action]
    if action == TAG and robot == opponent:
        after[OPPONENT] = opponent
        return TAG_REWARD, True
    after[OPPONENT] = parameters.opponent_moves[robot, opponent, int(5.0 * rng.random())]
    return -TAG_REWARD if action == TAG else STEP_REWARD, False


@kernel(inline=True)
def step(
    parameters: TagParameters, state: FloatArray, action: int, after: FloatArray, rng: np.random.Generator
) -> tuple[float, bool]:
    """Move or tag, and remember what is seen then."""
    reward, terminal = step_alone(parameters, state, action, after, rng)
    if terminal:
        for i in range(CHANCES, state.shape[0]):
            after[i] = state[i]
        return reward, True
    moved, opponent = int(after[ROBOT]), int(after[OPPONENT])
    remember(parameters, int(state[ROBOT]), moved, opponent, state[CHANCES:], after[CHANCES:])
    return reward, False


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
    """Tag where the opponent is seen, else look for it where that seems best by what was seen."""
    robot = int(state[ROBOT])
    if robot == int(state[OPPONENT]):
        return TAG
    return search_move(parameters, robot, state[CHANCES:])


@kernel(inline=True)
def random_action(parameters: TagParameters, state: FloatArray, rng: np.random.Generator) -> int:
    """Tag where the opponent is seen, else go anywhere."""
    return TAG if state[ROBOT] == state[OPPONENT] else int(4.0 * rng.random())


@kernel(inline=True)
def leaf_value(parameters: TagParameters, state: FloatArray) -> float:
    """Return the expected return of the default policy, given what was seen (not where the opponent is)."""
    robot = int(state[ROBOT])
    return TAG_REWARD if robot == int(state[OPPONENT]) else search_value(parameters, robot, state[CHANCES:])


@kernel(inline=True)
def step_of_advantages(
    parameters: TagParameters, state: FloatArray, action: int, after: FloatArray, rng: np.random.Generator
) -> tuple[float, bool]:
    """Move or tag; the reward is the action's advantage over the default policy π, Q^π − V^π.

    As in `problems.rock_sample`: the best policy is the same, and no luck is left in the rewards.
    """
    reward, terminal = step(parameters, state, action, after, rng)
    value = leaf_value(parameters, state)
    if terminal:
        return reward - value, True
    moved = int(after[ROBOT])
    chances = parameters.scratch[1]
    found = predict(parameters, int(state[ROBOT]), moved, state[CHANCES:], chances)
    ahead = found * TAG_REWARD
    if found < 1.0:
        for cell in range(chances.shape[0]):
            chances[cell] /= 1.0 - found
        ahead += (1.0 - found) * search_value(parameters, moved, chances)
    return reward + DISCOUNT * ahead - value, False


@kernel(inline=True)
def no_value(parameters: TagParameters, state: FloatArray) -> float:
    """Return 0: the default policy has no advantage over itself."""
    return 0.0


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
    for cell in range(state.shape[0] - CHANCES):
        here = 1.0 if cell == int(redrawn[ROBOT]) else 0.0
        redrawn[CHANCES + cell] = here if seen[0] < 0.0 else 1.0 / count


def tag(*, memory: bool = True, advantages: bool = False) -> Pomdp:
    """Return Tag.

    Args:
        advantages: whether the rewards are those of `step_of_advantages`: for planning.
        memory: whether the state holds what was seen, which the default policy goes by; without it the state is the two
            cells and the default policy walks at random, as in other planners' models: to compare speeds.
    """
    robot, opponent = robot_moves(CELLS), opponent_moves(CELLS)
    return Pomdp(
        name="benchmark_tag_advantages" if advantages else "benchmark_tag" if memory else "benchmark_tag_alone",
        state_dim=CHANCES + (len(CELLS) if memory else 0),
        observation_dim=1,
        action_count=5,
        discount=DISCOUNT,
        parameters=TagParameters(
            robot,
            opponent,
            fully_observable_solution(robot, opponent)[1],
            PATIENCE ** distances(robot),
            np.empty((2, len(CELLS))),
        ),
        initial=initial,
        step=step_of_advantages if advantages else step if memory else step_alone,
        observe=observe,
        likelihood=likelihood,
        rollout_action=rollout_action if memory else random_action,
        reinvigorate=reinvigorate,
        leaf_value=no_value if advantages else leaf_value if memory else None,
        legal=legal if memory else None,
    )
