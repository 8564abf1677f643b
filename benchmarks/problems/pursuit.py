"""Tables of the two pursuit problems, Tag and LaserTag: a robot chases an opponent over the cells of a floor.

The opponent flees (Pineau, Gordon and Thrun 2003; here as in DESPOT's C++ `base_tag.cpp`): with probability 0.4 one
cell away from the robot along x, 0.4 along y, 0.2 it stays; level with the robot along an axis it goes either way with
0.2 each; where there is no cell it stays. It sees the robot before the robot moves. So five outcomes of 0.2 each.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from skd_sim.arrays import FloatArray, IntArray
from skd_sim.kernels.compilation import kernel

NORTH, EAST, SOUTH, WEST, TAG = range(5)
DIRECTIONS: Final = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, -1), (-1, 1))
"""The four moves, then the four diagonals, anti-symmetric in pairs: the order of DESPOT's compass."""
TAG_REWARD: Final = 10.0
STEP_REWARD: Final = -1.0
DISCOUNT: Final = 0.95
PATIENCE: Final = 0.7
"""The default policy looks where P(opponent) · PATIENCE^distance is greatest."""
_NEGLIGIBLE: Final = 0.005  # discounted probability of an open end, which is worth at worst −20

Cell = tuple[int, int]


def robot_moves(cells: Sequence[Cell]) -> IntArray:
    """Return cells × 5: the cell after each action; towards a wall, or tagging, the robot stays."""
    index = {cell: i for i, cell in enumerate(cells)}
    moves = np.empty((len(cells), 5), np.int64)
    for i, (x, y) in enumerate(cells):
        for action in range(4):
            dx, dy = DIRECTIONS[action]
            moves[i, action] = index.get((x + dx, y + dy), i)
        moves[i, TAG] = i
    return moves


def opponent_moves(cells: Sequence[Cell]) -> IntArray:
    """Return robot cell × opponent cell × 5: the equally probable next cells of the opponent."""
    index = {cell: i for i, cell in enumerate(cells)}
    moves = np.empty((len(cells), len(cells), 5), np.int64)
    for i, (robot_x, robot_y) in enumerate(cells):
        for j, (x, y) in enumerate(cells):
            along_x = (1, -1) if x == robot_x else (1, 1) if x > robot_x else (-1, -1)
            along_y = (1, -1) if y == robot_y else (1, 1) if y > robot_y else (-1, -1)
            targets = [(x + d, y) for d in along_x] + [(x, y + d) for d in along_y] + [(x, y)]
            moves[i, j] = [index.get(target, j) for target in targets]
    return moves


def distances(robot: IntArray) -> IntArray:
    """Return moves from cell to cell, cell × cell."""
    count = len(robot)
    steps = np.where(np.eye(count, dtype=bool), 0, count)
    for _ in range(count):
        steps = np.minimum(steps, 1 + steps[robot[:, :TAG]].min(axis=1))
    return steps


def fully_observable_solution(robot: IntArray, opponent: IntArray) -> tuple[FloatArray, IntArray]:
    """Return optimal value and action, robot cell × opponent cell, when both are seen: value iteration to 1e-9."""
    count = len(robot)
    values = np.zeros((count, count))
    same = np.eye(count, dtype=bool)
    while True:
        ahead = np.stack([values[robot[:, a][:, None, None], opponent].mean(axis=2) for a in range(5)])
        q = np.full(5, STEP_REWARD)[:, None, None] + DISCOUNT * ahead
        q[TAG] += -TAG_REWARD - STEP_REWARD
        q[TAG][same] = TAG_REWARD
        after = q.max(axis=0)
        if np.abs(after - values).max() < 1e-9:
            return after, q.argmax(axis=0)
        values = after


@kernel(inline=True)
def predict(parameters: Any, robot: int, moved: int, chances: FloatArray, predicted: FloatArray) -> float:
    """Predict where the opponent goes; return the probability of the robot's next cell, and take it out."""
    count = chances.shape[0]
    for cell in range(count):
        predicted[cell] = 0.0
    for cell in range(count):
        share = 0.2 * chances[cell]
        if share > 0.0:
            for outcome in range(5):
                predicted[parameters.opponent_moves[robot, cell, outcome]] += share
    found = predicted[moved]
    predicted[moved] = 0.0
    return found


@kernel(inline=True)
def remember(parameters: Any, robot: int, moved: int, opponent: int, chances: FloatArray, after: FloatArray) -> None:
    """Say where the opponent may be after a move, by whether it is seen in the robot's next cell."""
    missed = 1.0 - predict(parameters, robot, moved, chances, after)
    if opponent == moved:
        after[:] = 0.0
        after[moved] = 1.0
    else:
        for cell in range(after.shape[0]):
            after[cell] /= missed


@kernel(inline=True)
def search_move(parameters: Any, robot: int, chances: FloatArray) -> int:
    """Return the move towards the cell where the opponent is probable and that is near."""
    best, target = 0.0, -1
    for cell in range(chances.shape[0]):
        score = chances[cell] * parameters.nearness[robot, cell]
        if cell != robot and score > best:
            best, target = score, cell
    return parameters.chase[robot, target] if target >= 0 else NORTH


@kernel
def search_value(parameters: Any, robot: int, chances: FloatArray) -> float:
    """Return the expected return of `search_move` where nothing is seen but the opponent in the robot's own cell.

    Until then there is but one thing to see, its absence: so one sequence of moves, and no tree.

    Args:
        parameters: with the tables of this module and `scratch`, 2 × cells.
        robot: its cell.
        chances: P(the opponent is in cell i); 0 for the robot's.
    """
    open_chances, predicted = parameters.scratch[0], parameters.scratch[1]
    for cell in range(chances.shape[0]):
        open_chances[cell] = chances[cell]
    value, open_end = 0.0, 1.0  # the probabilities are kept joint with "not seen yet"
    discount = 1.0
    while discount * open_end > _NEGLIGIBLE:
        value += discount * open_end * STEP_REWARD
        moved = parameters.robot_moves[robot, search_move(parameters, robot, open_chances)]
        found = predict(parameters, robot, moved, open_chances, predicted)
        discount *= DISCOUNT
        value += discount * found * TAG_REWARD
        open_end -= found
        open_chances, predicted = predicted, open_chances
        robot = moved
    return value
