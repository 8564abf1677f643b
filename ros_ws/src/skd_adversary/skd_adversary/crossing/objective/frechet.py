"""The kamikaze POMDP with the measure itself as objective: collide, at the least Fréchet distance from φ.

The paper's objective (`kamikaze`) charges every step with its distance to φ. The measure takes the longest link of the
best coupling of the whole of ψ with the whole of φ, and waiting on φ costs nothing. Here the coupling's row is part of
the state (`coupling`), so that the return of an episode that ends in a collision is the collision's reward less its
discrete Fréchet distance. With a maximum distance, a collision further away than that is worth no more than a miss.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.scenario import Scenario

from skd_adversary.crossing.coupling import first_row, next_row
from skd_adversary.crossing.crossing import ADVERSARY_X, ADVERSARY_Y, CAR_S, CAR_SPEED, TRIGGER, leads_nowhere
from skd_adversary.crossing.interfaces import ROW, left_behind, move, on_road, steer, velocity
from skd_adversary.crossing.parts import SEARCH, ObjectiveModel, template
from skd_adversary.crossing.road_user.pedestrian import (
    DIRECTION_EAST,
    EAST,
    NORTH,
    NORTH_EAST,
    SOUTH,
    SOUTH_EAST,
    STAY,
)

DISCOUNT: Final = 1.0
REWARDS: Final[Mapping[str, float]] = {"collision_reward": 10.0, "step_reward": -0.08}
"""In metres of Fréchet distance. A collision outweighs any distance on the road, so that a chance of missing of 1 % is
taken only for 0.1 m. A step costs 8 cm: looking at a standing car once more sharpens the estimate of where it stands by
less than that after a few looks, and without it an adversary looks on until the horizon."""

_MOST_DIAGONALS = 4  # more would come no nearer to the edge of the path for the steps that they take


@template("ROW")
def begin(parameters: Any, state: FloatArray) -> None:
    """Write the row of a ψ that has only its first point."""
    first_row(state[ADVERSARY_X], state[ADVERSARY_Y], parameters.path, state, ROW)


@template("velocity", "move", "on_road", "left_behind", "ROW")
def step(
    parameters: Any,
    state: FloatArray,
    action: int,
    next_state: FloatArray,
    rng: np.random.Generator,
) -> tuple[float, bool]:
    """Generative step: (reward, terminal); ends at a collision, or when there is none to come within the maximum."""
    p = parameters
    vx, vy = velocity(p, state, action)
    fraction = move(p, state, vx, vy, next_state, rng)
    hit = fraction <= 1.0
    x, y = next_state[ADVERSARY_X], next_state[ADVERSARY_Y]
    if hit:  # ψ ends where they touch
        x = state[ADVERSARY_X] + fraction * (x - state[ADVERSARY_X])
        y = state[ADVERSARY_Y] + fraction * (y - state[ADVERSARY_Y])
    least = next_row(x, y, p.path, state, next_state, ROW)
    limit = p.maximum_distance * p.maximum_distance
    if least > limit:
        return p.step_reward, True
    if hit:
        squared = next_state[next_state.shape[0] - 1]
        return p.step_reward + (p.collision_reward - math.sqrt(squared) if squared <= limit else 0.0), True
    across, along = on_road(p, x, y)
    if leads_nowhere(p, across, along, state[ADVERSARY_X], state[ADVERSARY_Y], x, y):
        return p.step_reward, True
    passed = left_behind(p, x, y, next_state[CAR_S]) and next_state[CAR_SPEED] > p.adversary_speed
    return p.step_reward, passed


@kernel(inline=True)
def _gains_by_diagonals(room: float, stride: float, ticks: float) -> bool:
    """Return whether diagonal steps among straight ones lead nearer to the edge of the path than these alone.

    Args:
        room: way to the edge of the car's path, m.
        stride: length of a step of the adversary, m.
        ticks: number of ticks until the car is here; infinity if it will not come.
    """
    diagonal = DIRECTION_EAST[NORTH_EAST] * stride
    nearest = room - math.floor(room / stride) * stride
    for count in range(1, _MOST_DIAGONALS):
        rest = room - count * diagonal
        if rest < 0.0:
            break
        straight = math.floor(rest / stride)
        rest -= straight * stride
        if rest < nearest - 1e-9 and straight + count + 0.5 < ticks:
            return True
    return False


@template("on_road")
def _way(parameters: Any, state: FloatArray) -> int:
    """Return where to go: as far across the car's path as the steps allow, abreast of φ's end; there meet the car.

    What is left of the distance at the end is the way from the contact to the end of φ, so contact should be at the far
    edge of the path and abreast of that end. If the car will stop short, the adversary walks up to it.
    """
    p = parameters
    y = state[ADVERSARY_Y]
    right, along = on_road(p, state[ADVERSARY_X], y)
    across = p.crossing * right
    gap = along - p.radius - state[CAR_S] - p.front
    if gap <= 0.0:  # alongside: into its side
        return SOUTH if across > 0.0 else EAST
    speed = state[CAR_SPEED]
    braking = gap + p.radius <= state[TRIGGER]
    stops_short = braking and 0.5 * speed * speed / p.deceleration < gap
    stride = p.adversary_speed * p.time_step
    diagonal = DIRECTION_EAST[NORTH_EAST] * stride
    room = p.half_width + p.radius - across
    aside = p.path[p.path.shape[0] - 1, 1] - y
    if room >= diagonal:
        ticks = math.inf if stops_short else gap / (speed * p.time_step)
        if room < stride or _gains_by_diagonals(room, stride, ticks):
            return NORTH_EAST if aside > 0.0 else SOUTH_EAST
        if abs(aside) > 0.5 * diagonal:
            return NORTH_EAST if aside > 0.0 else SOUTH_EAST
        return EAST
    if stops_short:
        return SOUTH
    if abs(aside) > 0.5 * stride:
        return NORTH if aside > 0.0 else SOUTH
    return STAY


@template("_way", "steer")
def rollout_action(parameters: Any, state: FloatArray, rng: np.random.Generator) -> int:
    """Default policy: see `_way`."""
    return steer(parameters, state, _way(parameters, state))


def parameters_of(scenario: Scenario, path: FloatArray) -> Mapping[str, float]:
    """Return the rewards."""
    return REWARDS


def own_dim(points: int) -> int:
    """Return the length of the coupling's row for φ of a number of points."""
    return points


OBJECTIVE: Final = ObjectiveModel(
    "frechet",
    DISCOUNT,
    replace(SEARCH, exploration=0.5, particles=1000),
    parameters_of,
    step=step,
    rollout_action=rollout_action,
    begin=begin,
    own_dim=own_dim,
)
