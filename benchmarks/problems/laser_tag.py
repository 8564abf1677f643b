"""LaserTag: Tag among random obstacles, with eight noisy laser readings and an unknown own position.

Introduced with DESPOT (Somani, Ye, Hsu and Lee 2013; Ye, Somani, Hsu and Lee 2017, JAIR 58); here as in its C++
(`AdaCompNUS/despot`, examples/cpp_models/tag/src/laser_tag): 7 × 11 cells, 8 of them obstacles drawn anew for each
episode and known to the robot; both start in any free cell. A beam in each of the eight directions gives the distance d
(in cells, √2 a diagonal step) to wall, obstacle or opponent as max(0, ⌊d − |N(0, 2.5²)|⌋), an integer. In the
opponent's cell the observation says so without error. All else is Tag.

`JuliaPOMDP/LaserTag.jl`, with which POMCPOW's −10.3 and DESPOT's −8.9 were measured (Sunberg and Kochenderfer 2018),
discretises the readings in the same way, but its episodes may also start inside of an obstacle, from where there is a
way out but none back in. Here, as in C++, they do not.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from skd_adversary.planning.pomdp import Pomdp
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel

from problems.pursuit import (
    DIRECTIONS,
    DISCOUNT,
    PATIENCE,
    STEP_REWARD,
    TAG,
    TAG_REWARD,
    Cell,
    IntArray,
    distances,
    fully_observable_solution,
    opponent_moves,
    remember,
    robot_moves,
    search_move,
    search_value,
)

ROWS: Final = 7
COLUMNS: Final = 11
OBSTACLES: Final = 8
SIGMA: Final = 2.5  # cells
ROBOT, OPPONENT, CHANCES = range(3)
"""State: two cells; from CHANCES on P(the opponent is in cell i | what was seen, the robot being where it is)."""
SIGHT: Final = 0.5
"""A leaf's value lies so far from that of a search that sees nothing more to that of a chase that sees all."""
_READINGS: Final = 16  # more than any distance: 11 straight, 7√2 < 10 diagonally


class LaserTagParameters(NamedTuple):
    """Tables: those of `problems.pursuit`, the readings, and memory for `leaf_value`.

    `ranges` (robot × opponent × 8) indexes `distances` (cells) and the rows of `chances`, P(reading | distance).
    """

    robot_moves: IntArray
    opponent_moves: IntArray
    values: FloatArray
    chase: IntArray
    nearness: FloatArray
    scratch: FloatArray
    ranges: IntArray
    distances: FloatArray
    chances: FloatArray


@kernel
def initial(parameters: LaserTagParameters, state: FloatArray, rng: np.random.Generator) -> None:
    """Put both into any free cell."""
    count = parameters.robot_moves.shape[0]
    state[ROBOT] = int(count * rng.random())
    state[OPPONENT] = int(count * rng.random())
    state[CHANCES:] = 1.0 / count


@kernel(inline=True)
def step(
    parameters: LaserTagParameters, state: FloatArray, action: int, after: FloatArray, rng: np.random.Generator
) -> tuple[float, bool]:
    """Move or tag, and remember whether the opponent is seen then; the readings follow with the observation."""
    robot, opponent = int(state[ROBOT]), int(state[OPPONENT])
    moved = parameters.robot_moves[robot, action]
    after[ROBOT] = moved
    if action == TAG and robot == opponent:
        for i in range(OPPONENT, state.shape[0]):
            after[i] = state[i]
        return TAG_REWARD, True
    opponent = parameters.opponent_moves[robot, opponent, int(5.0 * rng.random())]
    after[OPPONENT] = opponent
    remember(parameters, robot, moved, opponent, state[CHANCES:], after[CHANCES:])
    return -TAG_REWARD if action == TAG else STEP_REWARD, False


@kernel(inline=True)
def _remember(parameters: LaserTagParameters, state: FloatArray, seen: FloatArray) -> None:
    """Condition the state's probabilities on eight readings."""
    robot = int(state[ROBOT])
    total = 0.0
    for cell in range(parameters.robot_moves.shape[0]):
        if state[CHANCES + cell] > 0.0:
            chance = state[CHANCES + cell]
            for beam in range(8):
                chance *= parameters.chances[parameters.ranges[robot, cell, beam], int(seen[beam])]
            state[CHANCES + cell] = chance
            total += chance
    if total > 0.0:
        for i in range(CHANCES, state.shape[0]):
            state[i] /= total
    else:
        state[CHANCES + int(state[OPPONENT])] = 1.0


@kernel(inline=True)
def observe(
    parameters: LaserTagParameters, state: FloatArray, action: int, seen: FloatArray, rng: np.random.Generator
) -> None:
    """Read the eight beams; −1 from all of them: the opponent is here. The state remembers the readings."""
    if state[ROBOT] == state[OPPONENT]:
        seen[:] = -1.0
        return
    ranges = parameters.ranges[int(state[ROBOT]), int(state[OPPONENT])]
    for beam in range(8):
        reading = parameters.distances[ranges[beam]] - abs(SIGMA * rng.standard_normal())
        seen[beam] = math.floor(max(reading, 0.0))
    _remember(parameters, state, seen)


@kernel(inline=True)
def likelihood(parameters: LaserTagParameters, state: FloatArray, action: int, seen: FloatArray) -> float:
    """Return the probability of the eight readings. The state remembers them."""
    here = state[ROBOT] == state[OPPONENT]
    if here or seen[0] < 0.0:
        return 1.0 if here and seen[0] < 0.0 else 0.0
    ranges = parameters.ranges[int(state[ROBOT]), int(state[OPPONENT])]
    chance = 1.0
    for beam in range(8):
        chance *= parameters.chances[ranges[beam], int(seen[beam])]
    if chance > 0.0:
        _remember(parameters, state, seen)
    return chance


@kernel(inline=True)
def rollout_action(parameters: LaserTagParameters, state: FloatArray, rng: np.random.Generator) -> int:
    """Tag where the opponent is seen, else look for it where that seems best by what was seen."""
    robot = int(state[ROBOT])
    return TAG if robot == int(state[OPPONENT]) else search_move(parameters, robot, state[CHANCES:])


@kernel(inline=True)
def leaf_value(parameters: LaserTagParameters, state: FloatArray) -> float:
    """Return a value between that of searching on without lasers, and that of a chase from where the opponent is.

    Either by what was seen, that is in the mean over where the opponent may be. With lasers one sees something.
    """
    robot = int(state[ROBOT])
    if robot == int(state[OPPONENT]):
        return TAG_REWARD
    blind = search_value(parameters, robot, state[CHANCES:])
    sighted = 0.0
    for cell in range(parameters.robot_moves.shape[0]):
        sighted += state[CHANCES + cell] * parameters.values[robot, cell]
    return blind + SIGHT * (sighted - blind)


@kernel(inline=True)
def legal(parameters: LaserTagParameters, state: FloatArray, action: int) -> bool:
    """Return whether an action makes sense: tagging does where the opponent is seen, and elsewhere never."""
    return action != TAG or state[ROBOT] == state[OPPONENT]


@kernel
def reinvigorate(
    parameters: LaserTagParameters, state: FloatArray, seen: FloatArray, redrawn: FloatArray, rng: np.random.Generator
) -> None:
    """Nothing is known for sure but that both are, or are not, in the same cell."""
    count = parameters.robot_moves.shape[0]
    redrawn[ROBOT] = int(count * rng.random())
    redrawn[OPPONENT] = redrawn[ROBOT] if seen[0] < 0.0 else int(count * rng.random())
    for cell in range(count):
        here = 1.0 if cell == int(redrawn[ROBOT]) else 0.0
        redrawn[CHANCES + cell] = here if seen[0] < 0.0 else 1.0 / count


def random_cells(rng: np.random.Generator) -> tuple[Cell, ...]:
    """Return the free cells (column, row) of a floor with obstacles drawn without replacement."""
    blocked = set(rng.choice(ROWS * COLUMNS, OBSTACLES, replace=False).tolist())
    return tuple((i % COLUMNS, i // COLUMNS) for i in range(ROWS * COLUMNS) if i not in blocked)


def laser_ranges(cells: tuple[Cell, ...]) -> IntArray:
    """Return robot × opponent × 8: steps from the robot to what stops the beam, at least 1."""
    free = set(cells)
    ranges = np.empty((len(cells), len(cells), 8), np.int64)
    for i, (x, y) in enumerate(cells):
        for j, opponent in enumerate(cells):
            for beam, (dx, dy) in enumerate(DIRECTIONS):
                steps = 1
                while (x + steps * dx, y + steps * dy) in free and (x + steps * dx, y + steps * dy) != opponent:
                    steps += 1
                ranges[i, j, beam] = steps
    return ranges


def reading_chances(distances: FloatArray) -> FloatArray:
    """Return distance × reading: P(⌊max(0, d − |N(0, σ²)|)⌋ = reading)."""
    chances = np.zeros((len(distances), _READINGS))
    for i, distance in enumerate(distances):
        for reading in range(_READINGS):
            if reading > distance:
                break
            near = max(distance - (reading + 1), 0.0)
            beyond = math.erfc((distance - reading) / (SIGMA * math.sqrt(2.0))) if reading > 0 else 0.0
            chances[i, reading] = math.erfc(near / (SIGMA * math.sqrt(2.0))) - beyond
    return chances


def laser_tag(cells: tuple[Cell, ...]) -> Pomdp:
    """Return LaserTag on a floor with these free cells, see `random_cells`."""
    robot, opponent = robot_moves(cells), opponent_moves(cells)
    straight = np.arange(COLUMNS + 1, dtype=float)  # index: steps; the diagonal ones follow
    ranges = laser_ranges(cells)
    ranges[:, :, 4:] += len(straight)
    steps = np.concatenate([straight, math.sqrt(2.0) * straight[: ROWS + 1]])
    return Pomdp(
        name="benchmark_laser_tag",
        state_dim=CHANCES + len(cells),
        observation_dim=8,
        action_count=5,
        discount=DISCOUNT,
        parameters=LaserTagParameters(
            robot,
            opponent,
            *fully_observable_solution(robot, opponent),
            PATIENCE ** distances(robot),
            np.empty((2, len(cells))),
            ranges,
            steps,
            reading_chances(steps),
        ),
        initial=initial,
        step=step,
        observe=observe,
        likelihood=likelihood,
        rollout_action=rollout_action,
        reinvigorate=reinvigorate,
        leaf_value=leaf_value,
        legal=legal,
    )
