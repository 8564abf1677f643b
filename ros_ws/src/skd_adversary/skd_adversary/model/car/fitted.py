"""The crossing with a car that was fitted from logs: the same POMDPs, another predicted car.

What the fit leaves uncertain is part of the state: each of the parameters below is drawn from its prior in the initial
belief and carried along, so that the belief learns it. The rewards and the sensors are those of the crossing.
"""

from __future__ import annotations

import collections
import dataclasses
import dis
import functools
import math
import sys
from typing import Any, Final

import numpy as np
from skd_sim.compilation import kernel, specialise
from skd_sim.geometry import first_contact
from skd_sim.motion import draw_relative, next_speed, travelled

from skd_adversary.fitted_car import FittedCar
from skd_adversary.model import crossing
from skd_adversary.model.crossing import (
    CAR_SPEED,
    CAR_Y,
    DIRECTION_EAST,
    PEDESTRIAN_X,
    PEDESTRIAN_Y,
    STATE_DIM,
    TRIGGER,
    CrossingParameters,
    action_velocity,
    path_velocity,
    polyline_distance,
)
from skd_adversary.planning.pomdp import FloatArray, Pomdp

__all__ = [
    "DIRECTION_EAST",
    "action_velocity",
    "move",
    "path_velocity",
    "polyline_distance",
    "transition",
    "with_fitted_car",
]

# State vector, beyond the crossing's own
PATH, DECELERATION, DELAY, CRUISE, GAIN, LIMIT, SPEED_NOISE, PEDESTRIAN_VX, PEDESTRIAN_VY, MEMORY = range(
    STATE_DIM, STATE_DIM + 10
)
LONGEST_DELAY: Final = 3  # ticks
FITTED_STATE_DIM = MEMORY + LONGEST_DELAY

_PRIORS = (
    "trigger",
    "path_half_width",
    "deceleration",
    "reaction_delay",
    "cruise_speed",
    "cruise_gain",
    "cruise_acceleration",
    "speed_noise",
)
_TRIGGER, _PATH, _DECELERATION, _DELAY, _CRUISE, _GAIN, _LIMIT, _SPEED_NOISE = range(len(_PRIORS))
_NO_LIMIT = 1e9  # m/s²
_KINDS = {"point": 0.0, "uniform": 1.0, "normal": 2.0}
_FIELDS = ("by_time", "gate", "spread_kind", "spread", "priors")

# The parameters of the crossing and those of the car, in one tuple, so that the crossing's own kernels take it too.
_namedtuple: Any = collections.namedtuple  # whose fields are known at run time only
FittedParameters = _namedtuple("FittedParameters", (*CrossingParameters._fields, *_FIELDS))


@kernel
def _drawn(priors: FloatArray, row: int, rng: np.random.Generator) -> float:
    """Draw a parameter, which is never negative: a point, uniform(low, high), or normal(mean, deviation)."""
    if priors[row, 0] == 1.0:
        return float(priors[row, 1] + (priors[row, 2] - priors[row, 1]) * rng.random())
    if priors[row, 0] == 2.0:
        return float(max(0.0, priors[row, 1] + priors[row, 2] * rng.standard_normal()))
    return float(priors[row, 1])


@kernel
def _draw_policy(parameters: Any, state: FloatArray, rng: np.random.Generator) -> None:
    """Draw what is not known of the car's policy; it has decided nothing yet."""
    p = parameters
    trigger = _drawn(p.priors, _TRIGGER, rng)
    if p.spread_kind == 1.0:
        trigger = max(0.0, trigger + p.spread * rng.standard_normal())
    state[TRIGGER] = trigger
    state[PATH] = _drawn(p.priors, _PATH, rng)
    state[DECELERATION] = _drawn(p.priors, _DECELERATION, rng)
    state[DELAY] = min(float(LONGEST_DELAY), float(round(_drawn(p.priors, _DELAY, rng) / p.time_step)))
    state[CRUISE] = _drawn(p.priors, _CRUISE, rng)
    state[GAIN] = _drawn(p.priors, _GAIN, rng)
    state[LIMIT] = _drawn(p.priors, _LIMIT, rng)
    state[SPEED_NOISE] = _drawn(p.priors, _SPEED_NOISE, rng)
    for tick in range(LONGEST_DELAY):
        state[MEMORY + tick] = 0.0


@kernel
def initial_state(parameters: Any, state: FloatArray, rng: np.random.Generator) -> None:
    """Draw a state from the initial belief: the pedestrian is known, start and policy of the car are not."""
    crossing.initial_state(parameters, state, rng)
    state[PEDESTRIAN_VX] = 0.0
    state[PEDESTRIAN_VY] = 0.0
    _draw_policy(parameters, state, rng)


@kernel
def _in_reach(
    parameters: Any,
    trigger: float,
    path: float,
    x: float,
    y: float,
    vx: float,
    vy: float,
    car_y: float,
    speed: float,
) -> bool:
    """Return whether a pedestrian at (x, y) with velocity (vx, vy) makes the car brake; arguments in m and m/s."""
    p = parameters
    gap = y - car_y - p.front
    closing = speed - vy
    length = p.front + p.rear
    if p.by_time == 1.0:
        if closing <= 0.0 or gap < -length or max(gap, 0.0) > trigger * closing:
            return False
    elif gap < 0.0 or gap > trigger:
        return False
    if p.gate == 0.0:
        return True
    if p.gate == 1.0:
        return bool(abs(x) <= path)
    if closing <= 1e-9:
        return False
    begin = x + vx * max(gap, 0.0) / closing
    end = x + vx * max(gap + length, 0.0) / closing
    return bool(begin * end <= 0.0 or min(abs(begin), abs(end)) <= path)


@kernel
def brakes(parameters: Any, state: FloatArray, rng: np.random.Generator) -> bool:
    """Return whether the car decides to brake; the measures and paths of `car_fit.families`."""
    p = parameters
    trigger = state[TRIGGER]
    if p.spread_kind == 2.0:
        u = rng.random()
        trigger += p.spread * math.log((u + 1e-12) / (1.0 - u + 1e-12))
    return bool(
        _in_reach(
            p,
            trigger,
            state[PATH],
            state[PEDESTRIAN_X],
            state[PEDESTRIAN_Y],
            state[PEDESTRIAN_VX],
            state[PEDESTRIAN_VY],
            state[CAR_Y],
            state[CAR_SPEED],
        )
    )


@kernel
def foreseen_acceleration(
    parameters: Any,
    state: FloatArray,
    x: float,
    y: float,
    vx: float,
    vy: float,
    car_y: float,
    speed: float,
) -> float:
    """As `crossing.foreseen_acceleration`; it reacts at once."""
    if _in_reach(parameters, state[TRIGGER], state[PATH], x, y, vx, vy, car_y, speed):
        return float(-state[DECELERATION])
    return float(min(state[LIMIT], state[GAIN] * (state[CRUISE] - speed)))


@kernel
def transition(
    parameters: Any, state: FloatArray, action: int, next_state: FloatArray, rng: np.random.Generator
) -> float:
    """Write the next state and return when in the step car and pedestrian touch; as `crossing.transition`."""
    vx, vy = action_velocity(action, parameters.pedestrian_speed)
    return float(move(parameters, state, vx, vy, next_state, rng))


@kernel
def move(
    parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray, rng: np.random.Generator
) -> float:
    """As `transition`, of a pedestrian that moves with a velocity (East, North), m/s; as `crossing.move`."""
    p = parameters
    x, y = state[PEDESTRIAN_X], state[PEDESTRIAN_Y]
    x_after, y_after = x + p.time_step * vx, y + p.time_step * vy
    car_y, speed = state[CAR_Y], state[CAR_SPEED]
    decided = 1.0 if brakes(p, state, rng) else 0.0
    delay = int(state[DELAY])
    done = decided if delay == 0 else state[MEMORY + delay - 1]
    acceleration = min(state[LIMIT], state[GAIN] * (state[CRUISE] - speed))
    if done > 0.0:
        acceleration = -state[DECELERATION]
    speed_after = next_speed(speed, acceleration, draw_relative(state[SPEED_NOISE], rng), p.time_step)
    car_y_after = car_y + travelled(speed, speed_after, p.time_step)
    for k in range(TRIGGER, MEMORY):
        next_state[k] = state[k]
    for tick in range(LONGEST_DELAY - 1, 0, -1):
        next_state[MEMORY + tick] = state[MEMORY + tick - 1]
    next_state[MEMORY] = decided
    next_state[PEDESTRIAN_X] = x_after
    next_state[PEDESTRIAN_Y] = y_after
    next_state[PEDESTRIAN_VX] = vx
    next_state[PEDESTRIAN_VY] = vy
    next_state[CAR_Y] = car_y_after
    next_state[CAR_SPEED] = speed_after
    margin = p.radius + p.half_width
    if (x < -margin and x_after < -margin) or (x > margin and x_after > margin):
        return math.inf
    if y - car_y > p.front + p.radius and y_after - car_y_after > p.front + p.radius:
        return math.inf
    return first_contact(y - car_y, -x, y_after - car_y_after, -x_after, p.front, p.rear, p.half_width, p.radius)


@kernel
def reinvigorate_relative_position(
    parameters: Any, state: FloatArray, observation: FloatArray, redrawn: FloatArray, rng: np.random.Generator
) -> None:
    """As `crossing.reinvigorate_relative_position`, the car's policy drawn anew."""
    crossing.reinvigorate_relative_position(parameters, state, observation, redrawn, rng)
    _draw_policy(parameters, redrawn, rng)


@kernel
def reinvigorate_distance(
    parameters: Any, state: FloatArray, observation: FloatArray, redrawn: FloatArray, rng: np.random.Generator
) -> None:
    """As `crossing.reinvigorate_distance`, the car's policy drawn anew."""
    crossing.reinvigorate_distance(parameters, state, observation, redrawn, rng)
    _draw_policy(parameters, redrawn, rng)


def with_fitted_car(model: Pomdp, car: FittedCar) -> Pomdp:
    """Return a POMDP of the crossing in which a fitted car is predicted.

    Args:
        model: of the crossing, whatever its rewards and its sensor; what its state has beyond the crossing's own
            begins at the `ROW` of its module.
        car: what the logs showed.
    """
    priors = np.zeros((len(_PRIORS), 3))
    priors[_LIMIT, 1] = _NO_LIMIT
    for row, name in enumerate(_PRIORS):
        if name in car.parameters:
            prior = car.parameters[name].prior
            priors[row] = _KINDS[prior.distribution], prior.first, prior.second
    spread = car.parameters["trigger_spread"]
    kind = {"sharp": 0.0, "encounter": 1.0, "tick": 2.0}[car.spread]
    parameters = FittedParameters(
        *model.parameters,
        by_time=float(car.measure == "time"),
        gate={"none": 0.0, "position": 1.0, "predicted": 2.0}[car.gate],
        spread_kind=kind,
        spread=float(spread.estimate if spread.estimate is not None else spread.prior.first) if kind else 0.0,
        priors=priors,
    )
    name = f"{model.name}_fitted"
    return dataclasses.replace(
        model,
        name=name,
        state_dim=model.state_dim + FITTED_STATE_DIM - STATE_DIM,
        parameters=parameters,
        initial=_rebound(model.initial, name),
        step=_rebound(model.step, name),
        rollout_action=_rebound(model.rollout_action, name),
        legal=None if model.legal is None else _rebound(model.legal, name),
        reinvigorate=_rebound(model.reinvigorate, name),
    )


@functools.cache
def _rebound(function: Any, name: str) -> Any:
    """Return a kernel of a model, and what it calls of its module, with this one for `crossing`; always the same."""
    template = getattr(function, "py_func", function)  # plain where numba is told to leave Python as it is
    if template.__module__ == crossing.__name__:
        return globals()[template.__name__]
    bindings: dict[str, Any] = {"crossing": sys.modules[__name__], "ROW": FITTED_STATE_DIM}
    for called in {line.argval for line in dis.get_instructions(template) if line.opname == "LOAD_GLOBAL"}:
        helper = template.__globals__.get(called)
        if getattr(helper, "__module__", "") == template.__module__ and callable(helper):
            bindings[called] = _rebound(helper, name)
    inline = bool(getattr(function, "targetoptions", {}).get("forceinline"))
    return specialise(template, f"{name}_{template.__module__.rpartition('.')[2]}", bindings, inline=inline)
