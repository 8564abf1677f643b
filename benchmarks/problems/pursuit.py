"""Tables of the two pursuit problems, Tag and LaserTag: a robot chases an opponent over the cells of a floor.

The opponent flees (Pineau, Gordon and Thrun 2003; here as in DESPOT's C++ `base_tag.cpp`): with probability 0.4 one
cell away from the robot along x, 0.4 along y, 0.2 it stays; level with the robot along an axis it goes either way with
0.2 each; where there is no cell it stays. It sees the robot before the robot moves. So five outcomes of 0.2 each.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
from skd_adversary.pomdp import FloatArray

IntArray = npt.NDArray[np.int64]

NORTH, EAST, SOUTH, WEST, TAG = range(5)
DIRECTIONS: Final = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, -1), (-1, 1))
"""The four moves, then the four diagonals, anti-symmetric in pairs: the order of DESPOT's compass."""
TAG_REWARD: Final = 10.0
STEP_REWARD: Final = -1.0
DISCOUNT: Final = 0.95

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


def fully_observable_solution(robot: IntArray, opponent: IntArray, slip: float = 0.0) -> tuple[FloatArray, IntArray]:
    """Return optimal value and action, robot cell × opponent cell, when both are seen: value iteration to 1e-9.

    Args:
        robot: of `robot_moves`.
        opponent: of `opponent_moves`.
        slip: probability that the robot makes one of its four moves at random instead, unless in the opponent's cell.
    """
    count = len(robot)
    values = np.zeros((count, count))
    same = np.eye(count, dtype=bool)
    while True:
        ahead = np.stack([values[robot[:, a][:, None, None], opponent].mean(axis=2) for a in range(5)])
        q = np.full(5, STEP_REWARD)[:, None, None] + DISCOUNT * ahead
        q[TAG] += -TAG_REWARD - STEP_REWARD
        q[TAG][same] = TAG_REWARD
        after = np.where(same, q.max(axis=0), (1.0 - slip) * q.max(axis=0) + slip * q[:TAG].mean(axis=0))
        if np.abs(after - values).max() < 1e-9:
            return after, q.argmax(axis=0)
        values = after
