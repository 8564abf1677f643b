"""The kamikaze POMDP of the deformation: collide, having strayed as little as possible from where φ is at the time.

The deformation of a pair is max over 0 ≤ t ≤ t_c of ‖ψ(t) − φ(t)‖, with t_c the contact and φ held at its last point
after its end (DESIGN: a distance in space and time). Both move uniformly within a tick, and the norm of a linear
function is convex, so ticks and contact suffice. Running maximum and tick are part of the state, so that the return of
an episode that ends in a collision is the collision's reward less its deformation. A maximum distance is a budget: who
has strayed further has lost, whatever he hits.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from skd_sim.compilation import kernel
from skd_sim.scenario import Scenario

from skd_adversary import crossing
from skd_adversary.car_model import CarModel
from skd_adversary.crossing import (
    ACTION_COUNT,
    AS_PHI,
    CAR_SPEED,
    CAR_Y,
    EAST,
    NORTH,
    NORTH_EAST,
    PEDESTRIAN_X,
    PEDESTRIAN_Y,
    SOUTH,
    SOUTH_EAST,
    STATE_DIM,
    STAY,
    CrossingParameters,
)
from skd_adversary.pomdp import FloatArray, Pomdp

DISCOUNT: Final = 1.0
REWARDS: Final[Mapping[str, float]] = {"collision_reward": 10.0, "step_reward": -0.02}
"""In metres of deformation."""

ROW: Final = STATE_DIM
"""Where the state's own part begins: the greatest squared distance so far (m²), then the tick."""
OWN: Final = 2
"""Length of that part."""


@kernel
def initial_state(parameters: CrossingParameters, state: FloatArray, rng: np.random.Generator) -> None:
    """Draw a state from the initial belief; the pedestrian is where φ begins."""
    crossing.initial_state(parameters, state, rng)
    dx, dy = state[PEDESTRIAN_X] - parameters.path[0, 0], state[PEDESTRIAN_Y] - parameters.path[0, 1]
    state[ROW] = dx * dx + dy * dy
    state[ROW + 1] = 0.0


@kernel(inline=True)
def _velocity(parameters: CrossingParameters, action: int, tick: int) -> tuple[float, float]:
    """Return the pedestrian's velocity (East, North), m/s, under an action at a tick."""
    if action == AS_PHI:
        return crossing.path_velocity(parameters.path, tick, parameters.time_step)
    return crossing.action_velocity(action, parameters.pedestrian_speed)


@kernel(inline=True)
def _strayed(path: FloatArray, x: float, y: float, tick: int, share: float) -> float:
    """Return the squared distance (m²) from (x, y) to where φ is a share of a tick after a tick."""
    last = path.shape[0] - 1
    begin, end = min(tick, last), min(tick + 1, last)
    dx = x - path[begin, 0] - share * (path[end, 0] - path[begin, 0])
    dy = y - path[begin, 1] - share * (path[end, 1] - path[begin, 1])
    return dx * dx + dy * dy


@kernel(inline=True)
def step(
    parameters: CrossingParameters,
    state: FloatArray,
    action: int,
    next_state: FloatArray,
    rng: np.random.Generator,
) -> tuple[float, bool]:
    """Generative step: (reward, terminal); ends at a collision, or when there is none to come within the maximum."""
    p = parameters
    tick = int(state[ROW + 1])
    vx, vy = _velocity(p, action, tick)
    fraction = crossing.move(p, state, vx, vy, next_state, rng)
    hit = fraction <= 1.0
    x, y = next_state[PEDESTRIAN_X], next_state[PEDESTRIAN_Y]
    share = 1.0
    if hit:  # ψ ends where they touch
        share = fraction
        x = state[PEDESTRIAN_X] + share * (x - state[PEDESTRIAN_X])
        y = state[PEDESTRIAN_Y] + share * (y - state[PEDESTRIAN_Y])
    squared = max(state[ROW], _strayed(p.path, x, y, tick, share))
    next_state[ROW] = squared
    next_state[ROW + 1] = state[ROW + 1] + 1.0
    if squared > p.maximum_distance * p.maximum_distance:
        return p.step_reward, True
    if hit:
        return p.step_reward + p.collision_reward - math.sqrt(squared), True
    if x > p.half_width + p.radius:  # no action leads back
        return p.step_reward, True
    passed = next_state[CAR_Y] - p.rear > y + p.radius and next_state[CAR_SPEED] > p.pedestrian_speed
    return p.step_reward, passed


@kernel(inline=True)
def rollout_action(parameters: CrossingParameters, state: FloatArray, rng: np.random.Generator) -> int:
    """Default policy: v1."""
    p = parameters
    x, y = state[PEDESTRIAN_X], state[PEDESTRIAN_Y]
    edge = p.half_width + p.radius
    gap = y - p.radius - state[CAR_Y] - p.front
    if gap <= 0.0:  # alongside: into its side
        return SOUTH if x > 0.0 else EAST
    trigger, deceleration = crossing.foresight(p, state)
    speed = state[CAR_SPEED]
    free = max(0.0, gap + p.radius - trigger)  # way until it brakes
    rest = gap - free
    stops_short = free < gap and 0.5 * speed * speed < deceleration * rest
    stride = p.pedestrian_speed * p.time_step
    tick = int(state[ROW + 1])
    last = p.path.shape[0] - 1
    begin, then = min(tick, last), min(tick + 1, last)
    along_x = p.path[then, 0] - p.path[begin, 0]
    along_y = p.path[then, 1] - p.path[begin, 1]
    if stops_short:
        if x < -edge:
            return AS_PHI if free > 0.0 else SOUTH_EAST
        if free > 0.0:
            return AS_PHI if x + along_x < edge else STAY
        return SOUTH
    if free >= gap:
        time = gap / max(speed, 1e-3)
    else:
        time = free / max(speed, 1e-3)
        time += (speed - math.sqrt(max(0.0, speed * speed - 2.0 * deceleration * rest))) / deceleration
    ticks = time / p.time_step
    k = min(tick + int(ticks), last)
    ahead = x + p.path[k, 0] - p.path[begin, 0]  # where φ's way takes him until then
    if ahead > edge:
        if x + along_x <= edge:
            return AS_PHI
        return STAY
    if ahead < -edge:
        return EAST
    return AS_PHI


@kernel
def reinvigorate_relative_position(
    parameters: CrossingParameters,
    state: FloatArray,
    observation: FloatArray,
    redrawn: FloatArray,
    rng: np.random.Generator,
) -> None:
    """As `crossing.reinvigorate_relative_position`; how far he has strayed is known for sure."""
    crossing.reinvigorate_relative_position(parameters, state, observation, redrawn, rng)
    redrawn[ROW:] = state[ROW:]


@kernel
def reinvigorate_distance(
    parameters: CrossingParameters,
    state: FloatArray,
    observation: FloatArray,
    redrawn: FloatArray,
    rng: np.random.Generator,
) -> None:
    """As `crossing.reinvigorate_distance`; how far he has strayed is known for sure."""
    crossing.reinvigorate_distance(parameters, state, observation, redrawn, rng)
    redrawn[ROW:] = state[ROW:]


def deformation_kamikaze_pomdp(
    scenario: Scenario,
    car_model: CarModel,
    *,
    start: tuple[float, float],
    gap: float,
    path: FloatArray,
    maximum_distance: float | None = None,
) -> Pomdp:
    """Return the POMDP for one safe trajectory.

    Args:
        scenario: fixed description of the test.
        car_model: what the adversary thinks of the car.
        start: the pedestrian's start (x, y), m: the first point of φ.
        gap: front bumper to the crossing line before the episode's draw, m.
        path: φ, n × 2, m, one point per tick.
        maximum_distance: from φ at any time, m; none by default.
    """
    parameters = crossing.crossing_parameters(
        scenario, car_model, start=start, gap=gap, rewards=REWARDS, path=path, maximum_distance=maximum_distance
    )
    overrides: dict[str, Any] = {
        "initial": initial_state,
        "reinvigorate": reinvigorate_relative_position if car_model.observes_position else reinvigorate_distance,
    }
    return crossing.crossing_pomdp(
        "deformation_kamikaze",
        parameters,
        car_model,
        discount=DISCOUNT,
        step=step,
        rollout_action=rollout_action,
        state_dim=ROW + OWN,
        action_count=ACTION_COUNT + 1,
        **overrides,
    )
