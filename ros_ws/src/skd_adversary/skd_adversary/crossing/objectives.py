"""What the adversary wants: the safe crossing, the paper's kamikaze, and the kamikaze of least Fréchet distance.

The kamikaze of least deviation stands in `kamikaze`. Objectives of kamikazes are found by name
(`skd_sim.options.car_and_adversary.OBJECTIVES`), those of installed packages among them.

*Safe*, 𝒫° (paper, section "Generating Safe Trajectories"): reach the destination as fast as possible without a
collision. The car that it is played against need not be the one under test; here it is the most cautious basic car of
the paper.

*Paper*, 𝒫† (section "Generating Kamikaze Trajectories"): collide as fast as possible while staying near φ: high reward
at a collision, a penalty per step proportional to the distance between the adversary's position and φ, discounted.

*Fréchet*: collide, at the least discrete Fréchet distance from φ. The paper's objective charges every step with its
distance to φ; the measure takes the longest link of the best coupling of the whole of ψ with the whole of φ, and
waiting on φ costs nothing. Here the coupling's row is part of the state, so that the return of an episode that ends in
a collision is the collision's reward less its discrete Fréchet distance. With a maximum distance, a collision further
away than that is worth no more than a miss.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.kernels.compilation import kernel
from skd_sim.options.car_and_adversary import OBJECTIVES
from skd_sim.world.contact import runs_into
from skd_sim.world.state import FloatArray

from skd_adversary.crossing.interfaces import (
    ADVERSARY_X,
    ADVERSARY_Y,
    CAR_S,
    CAR_SPEED,
    ROW,
    SEARCH,
    TRIGGER,
    ObjectiveModel,
    leads_nowhere,
    left_behind,
    move,
    on_road,
    steer,
    template,
    velocity,
    within,
)
from skd_adversary.crossing.road_users import DIRECTION_EAST, EAST, NORTH, NORTH_EAST, SOUTH, SOUTH_EAST, STAY


def objective_named(name: str) -> ObjectiveModel:
    """Return the objective of a name.

    Raises:
        UsageError: there is none, or it cannot be loaded.
    """
    found = OBJECTIVES.find(name)
    if not isinstance(found, ObjectiveModel):
        raise UsageError(f"objective {name!r} ({OBJECTIVES.target(name)}) must be an ObjectiveModel, got {found!r:.60}")
    return found


PAPER_REWARDS: Final[Mapping[str, float]] = {"collision_reward": 100.0, "distance_weight": 1.0}
"""The paper names no numbers. One step's delay costs (1 − γ)·100 = 5, as much as a step spent 5 m away from φ, so
"as fast as possible" and "close to φ" both count at the scale of a lane. The same for every car and every C."""


def polyline_segments(path: FloatArray) -> FloatArray:
    """Return the segments of a polyline as rows (x, y, Δx, Δy, 1/length²); 0 for the last where the length is.

    Args:
        path: n × 2, m; with one point, its only segment begins and ends there.
    """
    begin, end = (path[:-1], path[1:]) if len(path) > 1 else (path, path)
    along = end - begin
    squared = (along**2).sum(axis=1)
    inverse = np.divide(1.0, squared, out=np.zeros_like(squared), where=squared > 0.0)
    return np.column_stack([begin, along, inverse])


@kernel(inline=True)
def polyline_distance(x: float, y: float, segments: FloatArray) -> float:
    """Return the distance (m) from (x, y) to the polyline whose `polyline_segments` are given."""
    best = math.inf
    for i in range(segments.shape[0]):
        along_x, along_y = segments[i, 2], segments[i, 3]
        px, py = x - segments[i, 0], y - segments[i, 1]
        s = min(1.0, max(0.0, (px * along_x + py * along_y) * segments[i, 4]))
        dx, dy = px - s * along_x, py - s * along_y
        best = min(best, dx * dx + dy * dy)
    return math.sqrt(best)


@template
def _paper_step(
    parameters: Any, state: FloatArray, action: int, next_state: FloatArray, rng: np.random.Generator
) -> tuple[float, bool]:
    """Generative step: (reward, terminal).

    It ends at a collision, in what stands, or where the car cannot be met any more.
    """
    p = parameters
    vx, vy = velocity(p, state, action)
    hit = move(p, state, vx, vy, next_state, rng) <= 1.0
    distance = polyline_distance(next_state[ADVERSARY_X], next_state[ADVERSARY_Y], p.segments)
    reward = -p.distance_weight * distance
    if hit:
        return reward + p.collision_reward, True
    x, y = next_state[ADVERSARY_X], next_state[ADVERSARY_Y]
    return reward, leads_nowhere(p, state[ADVERSARY_X], state[ADVERSARY_Y], x, y)


@template
def _paper_rollout_action(parameters: Any, state: FloatArray, rng: np.random.Generator) -> int:
    """Default policy: into the car's path, then wait for the car or walk towards it; into its side if it is there."""
    p = parameters
    across, along = on_road(p, state[ADVERSARY_X], state[ADVERSARY_Y])
    alongside = state[CAR_S] + p.front >= along
    if p.crossing * across < -0.5 * p.half_width or alongside:
        return steer(p, state, EAST)
    return steer(p, state, SOUTH if rng.random() < 0.5 else STAY)


PAPER: Final = ObjectiveModel(
    "paper",
    0.95,
    replace(SEARCH, exploration=30.0),
    lambda scenario, path: {**PAPER_REWARDS, "segments": polyline_segments(np.asarray(path, dtype=np.float64))},
    step=_paper_step,
    rollout_action=_paper_rollout_action,
)


REFERENCE_MULTIPLIER: Final = 1.15
"""C of the car that synthetic safe trajectories are generated with: the safest of the paper's nine."""

SAFE_REWARDS: Final[Mapping[str, float]] = {
    "destination_reward": 100.0,
    "collision_reward": -200.0,
    "step_reward": -10.0,
}
"""The paper names no numbers. A collision costs two crossings; the step cost makes "as fast as possible" count, so that
the adversary gives way by a few decimetres rather than by metres."""


@template
def _safe_step(
    parameters: Any, state: FloatArray, action: int, next_state: FloatArray, rng: np.random.Generator
) -> tuple[float, bool]:
    """Generative step: (reward, terminal); ends at a collision, in an obstacle or at the destination."""
    p = parameters
    vx, vy = velocity(p, state, action)
    if move(p, state, vx, vy, next_state, rng) <= 1.0:
        return p.step_reward + p.collision_reward, True
    x, y = next_state[ADVERSARY_X], next_state[ADVERSARY_Y]
    if runs_into(p.obstacles, state[ADVERSARY_X], state[ADVERSARY_Y], x, y, p.core):
        return p.step_reward + p.collision_reward, True
    across, along = on_road(p, x, y)
    if within(p.arrival, across, along):
        return p.step_reward + p.destination_reward, True
    return p.step_reward, False


@template
def _safe_rollout_action(parameters: Any, state: FloatArray, rng: np.random.Generator) -> int:
    """Default policy: straight across."""
    return steer(parameters, state, EAST)


SAFE: Final = ObjectiveModel(
    "safe",
    0.95,
    replace(SEARCH, exploration=100.0),
    lambda scenario, path: SAFE_REWARDS,
    step=_safe_step,
    rollout_action=_safe_rollout_action,
)


FRECHET_REWARDS: Final[Mapping[str, float]] = {"collision_reward": 10.0, "step_reward": -0.08}
"""In metres of Fréchet distance. A collision outweighs any distance on the road, so that a chance of missing of 1 % is
taken only for 0.1 m. A step costs 8 cm: looking at a standing car once more sharpens the estimate of where it stands by
less than that after a few looks, and without it an adversary looks on until the horizon."""

_MOST_DIAGONALS = 4  # more would come no nearer to the edge of the path for the steps that they take


# The discrete Fréchet distance, one point of ψ at a time: Eiter and Mannila (TR CD-TR 94/64, 1994) fill a table c[i, j]
# row by row; a row is all that the next one needs. Carried in the state, the row makes the bottleneck of the whole
# trajectory a function of state and next point. Values are squared distances, m².


@kernel(inline=True)
def first_row(x: float, y: float, path: FloatArray, rows: FloatArray, begin: int) -> None:
    """Write the row of ψ = ((x, y)): entry j is the squared distance of ψ to the first j + 1 points of φ.

    Args:
        x: place of the new point of ψ to the East, m.
        y: place of the new point of ψ to the North, m.
        path: φ, n × 2, m.
        rows: array whose entries begin … begin + n − 1 are the row, m²; written.
        begin: index at which the row begins. (A slice would cost more than the row.)
    """
    worst = 0.0
    for j in range(path.shape[0]):
        dx, dy = x - path[j, 0], y - path[j, 1]
        worst = max(worst, dx * dx + dy * dy)
        rows[begin + j] = worst


@kernel(inline=True)
def next_row(x: float, y: float, path: FloatArray, rows: FloatArray, after: FloatArray, begin: int) -> float:
    """Write the row of ψ extended by (x, y), and return its least value: no continuation can come closer than that.

    Args:
        x: place of the new point of ψ to the East, m.
        y: place of the new point of ψ to the North, m.
        path: φ, n × 2, m.
        rows: holds the row of ψ so far, as in `first_row`; may be `after` itself.
        after: receives the new row at the same place.
        begin: index at which the row begins.
    """
    diagonal = math.inf  # c[i − 1, j − 1]
    beside = math.inf  # c[i, j − 1]
    least = math.inf
    for j in range(path.shape[0]):
        above = rows[begin + j]
        dx, dy = x - path[j, 0], y - path[j, 1]
        link = dx * dx + dy * dy
        reach = above if above < diagonal else diagonal
        reach = beside if beside < reach else reach
        diagonal = above
        beside = link if link > reach else reach
        after[begin + j] = beside
        least = beside if beside < least else least
    return least


@template
def _frechet_begin(parameters: Any, state: FloatArray) -> None:
    """Write the row of a ψ that has only its first point."""
    first_row(state[ADVERSARY_X], state[ADVERSARY_Y], parameters.path, state, ROW)


@template
def _frechet_step(
    parameters: Any, state: FloatArray, action: int, next_state: FloatArray, rng: np.random.Generator
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
    if leads_nowhere(p, state[ADVERSARY_X], state[ADVERSARY_Y], x, y):
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


@template
def _direction(parameters: Any, state: FloatArray) -> int:
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


@template
def _frechet_rollout_action(parameters: Any, state: FloatArray, rng: np.random.Generator) -> int:
    """Default policy: see `_direction`."""
    return steer(parameters, state, _direction(parameters, state))


FRECHET: Final = ObjectiveModel(
    "frechet",
    1.0,
    replace(SEARCH, exploration=0.5, particles=1000),
    lambda scenario, path: FRECHET_REWARDS,
    step=_frechet_step,
    rollout_action=_frechet_rollout_action,
    begin=_frechet_begin,
    own_dim=lambda points: points,
)
