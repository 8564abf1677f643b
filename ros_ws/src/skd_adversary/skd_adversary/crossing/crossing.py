"""What all models of the adversary share: state, transition, and drawing a state that agrees with what was seen.

State (paper, "Generating Kamikaze Trajectories"): road user × predicted car × parameters of the car's policy, behind
them what a kind of car, a kind of road user and the objective have of their own. The car's place is its path coordinate
s along the road's centre line (`skd_sim.scenario.road`): y on the straight lane.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.ending import inside
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import runs_into

from skd_adversary.crossing.interfaces import (
    advance_car,
    begin,
    contact,
    place_car,
    pointing,
    redraw_policy,
    resume_car,
    settle,
    start_car,
    start_road_user,
)
from skd_adversary.crossing.parts import template

# State vector; the trigger is the distance within which the car brakes, m (s for some learned cars)
ADVERSARY_X, ADVERSARY_Y, CAR_S, CAR_SPEED, TRIGGER = range(5)
STATE_DIM = 5


within = kernel(inline=True)(inside)
"""As `skd_sim.scenario.ending.inside`, for kernels."""


@kernel(inline=True)
def leads_nowhere(
    parameters: Any, across: float, along: float, x: float, y: float, x_after: float, y_after: float
) -> bool:
    """Return whether a step ends where the car cannot be met any more, or leads into something that stands.

    Args:
        parameters: parameters of the model.
        across: offset to the right of the road's centre line at the end of the step, m.
        along: path coordinate at the end of the step, m.
        x: place to the East at the beginning of the step, m.
        y: place to the North at the beginning of the step, m.
        x_after: place to the East at the end of the step, m.
        y_after: place to the North at the end of the step, m.
    """
    p = parameters
    if within(p.loss, across, along):
        return True
    # On an open road the call alone would take as long as the rest of a step.
    return p.obstacles.shape[0] > 0 and runs_into(p.obstacles, x, y, x_after, y_after, p.core)


@template("start_road_user", "start_car", "begin", inline=False)
def initial_state(parameters: Any, state: FloatArray, rng: np.random.Generator) -> None:
    """Draw a state from the initial belief: the adversary's own state is known, start and policy of the car are not."""
    state[ADVERSARY_X] = parameters.start_x
    state[ADVERSARY_Y] = parameters.start_y
    start_road_user(parameters, state)
    start_car(parameters, state, rng)
    begin(parameters, state)


@template("advance_car", "settle", "pointing", "contact")
def move(
    parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray, rng: np.random.Generator
) -> float:
    """Interface `move`: both move uniformly within the step."""
    p = parameters
    x, y = state[ADVERSARY_X], state[ADVERSARY_Y]
    x_after, y_after = x + p.time_step * vx, y + p.time_step * vy
    advance_car(p, state, vx, vy, next_state, rng)
    next_state[ADVERSARY_X] = x_after
    next_state[ADVERSARY_Y] = y_after
    settle(p, state, vx, vy, next_state)
    return contact(p, x, y, x_after, y_after, pointing(p, state, vx, vy), state[CAR_S], next_state[CAR_S])


@template("resume_car", "place_car", "redraw_policy", inline=False)
def reinvigorate(
    parameters: Any, state: FloatArray, observation: FloatArray, redrawn: FloatArray, rng: np.random.Generator
) -> None:
    """Keep the adversary's own state and all else that is known for sure; draw the car anew where it was observed."""
    redrawn[STATE_DIM:] = state[STATE_DIM:]
    redrawn[ADVERSARY_X] = state[ADVERSARY_X]
    redrawn[ADVERSARY_Y] = state[ADVERSARY_Y]
    resume_car(parameters, state, redrawn, rng)
    place_car(parameters, state, observation, redrawn, rng)
    redraw_policy(parameters, redrawn, rng)


def crossing_parameters(
    scenario: Scenario,
    *,
    start: tuple[float, float],
    gap: float,
    path: FloatArray,
    maximum_distance: float | None = None,
) -> Mapping[str, Any]:
    """Return the parameters that every model has, by name; lengths in m, speeds in m/s, times in s.

    Args:
        scenario: fixed description of the test.
        start: place (x, y) where the adversary starts, m.
        gap: distance from the front bumper to the crossing line before the episode's draw, m.
        path: φ, n × 2, m; a single row where there is no φ.
        maximum_distance: greatest distance from φ, m; by default there is no limit.
    """
    car, adversary = scenario.car, scenario.adversary
    nearest = -gap - car.front
    return {
        "time_step": scenario.time_step,
        "front": car.front,
        "rear": car.rear,
        "half_width": car.half_width,
        "radius": adversary.reach,
        "adversary_speed": adversary.speed,
        "start_x": float(start[0]),
        "start_y": float(start[1]),
        "crossing": scenario.end.crossing,
        "arrival": scenario.end.arrival,
        "loss": scenario.end.loss,
        "car_start_low": nearest - car.start_gap_range,  # s of the car's reference point
        "car_start_high": nearest,
        "car_start_speed": car.start_speed,
        "deceleration": car.deceleration,
        "maximum_distance": math.inf if maximum_distance is None else maximum_distance,
        "obstacles": np.array(scenario.rectangles),  # a copy, as of φ
        "core": adversary.core,
        "path": np.array(path, dtype=np.float64, order="C"),  # a copy: one type for kernels, read-only or not
    }
