"""A car that was fitted from logs, as the adversary predicts it.

What the fit leaves uncertain is part of the state: each of the parameters below is drawn from its prior in the initial
belief and carried along, so that the belief learns it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import draw_relative, next_speed, travelled

from skd_adversary.car_models.fitted_car import LONGEST_DELAY, FittedCar
from skd_adversary.crossing.car import basic
from skd_adversary.crossing.crossing import ADVERSARY_X, ADVERSARY_Y, CAR_S, CAR_SPEED, STATE_DIM, TRIGGER
from skd_adversary.crossing.interfaces import on_road, velocity_on_road
from skd_adversary.crossing.parts import CarKernels, Sensor, template

# State vector, beyond the crossing's own
PATH, DECELERATION, DELAY, CRUISE, GAIN, LIMIT, SPEED_NOISE, ADVERSARY_VX, ADVERSARY_VY, MEMORY = range(
    STATE_DIM, STATE_DIM + 10
)
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


@kernel
def _drawn(priors: FloatArray, row: int, rng: np.random.Generator) -> float:
    """Draw a parameter, which is never negative: a point, uniform(low, high), or normal(mean, deviation)."""
    if priors[row, 0] == 1.0:
        return float(priors[row, 1] + (priors[row, 2] - priors[row, 1]) * rng.random())
    if priors[row, 0] == 2.0:
        return float(max(0.0, priors[row, 1] + priors[row, 2] * rng.standard_normal()))
    return float(priors[row, 1])


@kernel
def redraw_policy(parameters: Any, state: FloatArray, rng: np.random.Generator) -> None:
    """Interface `redraw_policy`: draw what is not known; it has decided nothing yet."""
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
def start_car(parameters: Any, state: FloatArray, rng: np.random.Generator) -> None:
    """Interface `start_car`: where the basic car starts."""
    basic.start_car(parameters, state, rng)
    state[ADVERSARY_VX] = 0.0
    state[ADVERSARY_VY] = 0.0
    redraw_policy(parameters, state, rng)


@template("on_road", "velocity_on_road", inline=False)
def _in_reach(
    parameters: Any,
    trigger: float,
    path: float,
    x: float,
    y: float,
    vx: float,
    vy: float,
    car_s: float,
    speed: float,
) -> bool:
    """Return whether an adversary at (x, y) with velocity (vx, vy) makes the car brake; arguments in m and m/s."""
    p = parameters
    across, along = on_road(p, x, y)
    v_across, v_along = velocity_on_road(p, x, y, vx, vy)
    gap = along - car_s - p.front
    closing = speed - v_along
    length = p.front + p.rear
    if p.by_time == 1.0:
        if closing <= 0.0 or gap < -length or max(gap, 0.0) > trigger * closing:
            return False
    elif gap < 0.0 or gap > trigger:
        return False
    if p.gate == 0.0:
        return True
    if p.gate == 1.0:
        return bool(abs(across) <= path)
    if closing <= 1e-9:
        return False
    begin = across + v_across * max(gap, 0.0) / closing
    end = across + v_across * max(gap + length, 0.0) / closing
    return bool(begin * end <= 0.0 or min(abs(begin), abs(end)) <= path)


@template("_in_reach", inline=False)
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
            state[ADVERSARY_X],
            state[ADVERSARY_Y],
            state[ADVERSARY_VX],
            state[ADVERSARY_VY],
            state[CAR_S],
            state[CAR_SPEED],
        )
    )


@template("_in_reach", inline=False)
def foreseen_acceleration(
    parameters: Any,
    state: FloatArray,
    x: float,
    y: float,
    vx_before: float,
    vy_before: float,
    vx: float,
    vy: float,
    car_s: float,
    speed: float,
    change: float,
    change_before: float,
) -> float:
    """Interface `foreseen_acceleration`; it reacts at once."""
    if _in_reach(parameters, state[TRIGGER], state[PATH], x, y, vx_before, vy_before, car_s, speed):
        return float(-state[DECELERATION])
    return float(min(state[LIMIT], state[GAIN] * (state[CRUISE] - speed)))


@template("brakes", inline=False)
def advance_car(
    parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray, rng: np.random.Generator
) -> None:
    """Interface `advance_car`."""
    p = parameters
    car_s, speed = state[CAR_S], state[CAR_SPEED]
    decided = 1.0 if brakes(p, state, rng) else 0.0
    delay = int(state[DELAY])
    done = decided if delay == 0 else state[MEMORY + delay - 1]
    acceleration = min(state[LIMIT], state[GAIN] * (state[CRUISE] - speed))
    if done > 0.0:
        acceleration = -state[DECELERATION]
    speed_after = next_speed(speed, acceleration, draw_relative(state[SPEED_NOISE], rng), p.time_step)
    car_s_after = car_s + travelled(speed, speed_after, p.time_step)
    for k in range(TRIGGER, MEMORY):
        next_state[k] = state[k]
    for tick in range(LONGEST_DELAY - 1, 0, -1):
        next_state[MEMORY + tick] = state[MEMORY + tick - 1]
    next_state[MEMORY] = decided
    next_state[ADVERSARY_VX] = vx
    next_state[ADVERSARY_VY] = vy
    next_state[CAR_S] = car_s_after
    next_state[CAR_SPEED] = speed_after


KERNELS = CarKernels(
    "fitted",
    FITTED_STATE_DIM - STATE_DIM,
    start_car,
    advance_car,
    foreseen_acceleration,
    basic.resume_car,
    redraw_policy,
    basic.last_changes,
)


@dataclass(frozen=True)
class LearnedCar:
    """A car that behaves by the law that was fitted to its logs.

    Attributes:
        car: fitted law of the car, with its parameters.
        known: what is known of the car without its logs; it gives the sensor.
    """

    car: FittedCar
    known: basic.CarModel

    @property
    def kernels(self) -> CarKernels:
        """Kernels of how the predicted car moves."""
        return KERNELS

    @property
    def sensor(self) -> Sensor:
        """Sensor by which the adversary sees the car."""
        return self.known.sensor

    def parameters(self, scenario: Scenario) -> Mapping[str, Any]:
        """Return the law of the car as numbers, and its priors: one row each, kind and two numbers (SI)."""
        car = self.car
        priors = np.zeros((len(_PRIORS), 3))
        priors[_LIMIT, 1] = _NO_LIMIT
        for row, name in enumerate(_PRIORS):
            if name in car.parameters:
                prior = car.parameters[name].prior
                priors[row] = _KINDS[prior.distribution], prior.first, prior.second
        spread = car.parameters["trigger_spread"]
        kind = {"sharp": 0.0, "encounter": 1.0, "tick": 2.0}[car.spread]
        return {
            **self.known.parameters(scenario),
            "by_time": float(car.measure == "time"),
            "gate": {"none": 0.0, "position": 1.0, "predicted": 2.0}[car.gate],
            "spread_kind": kind,
            "spread": float(spread.estimate if spread.estimate is not None else spread.prior.first) if kind else 0.0,
            "priors": priors,
            **({} if car.waiting_reward is None else {"waiting_reward": car.waiting_reward}),
        }
