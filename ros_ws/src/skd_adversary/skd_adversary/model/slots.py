"""What a template may call by name; the composer binds each to the part of the model at hand.

States are vectors as in `crossing`, velocities (East, North) in m/s, `parameters` those of the composed model.
"""

from __future__ import annotations

from typing import Any, Final, cast

import numpy as np

from skd_adversary.planning.pomdp import FloatArray

_UNBOUND = "bound by the composer"
_NO_NUMBER = cast(int, None)  # with which no kernel compiles

ROW: Final = _NO_NUMBER
"""Where the objective's own part of a state begins."""
AS_PHI: Final = _NO_NUMBER
"""The action *as φ*: the displacement that φ makes in the present tick, none after its end."""


# --- the road user's


def velocity(parameters: Any, state: FloatArray, action: int) -> tuple[float, float]:
    """Return the velocity under an action of the road user."""
    raise NotImplementedError(_UNBOUND)


# --- the predicted car's


def start_car(parameters: Any, state: FloatArray, rng: np.random.Generator) -> None:
    """Draw place, speed and policy of the car into a state of the initial belief."""
    raise NotImplementedError(_UNBOUND)


def advance_car(
    parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray, rng: np.random.Generator
) -> None:
    """Write all of the car's part of the next state, the road user moving with a velocity."""
    raise NotImplementedError(_UNBOUND)


def foreseen_acceleration(
    parameters: Any, state: FloatArray, x: float, y: float, vx: float, vy: float, car_y: float, speed: float
) -> float:
    """Return what the car of a state will do (m/s²), its noise left aside, once it and the road user have moved.

    Args:
        parameters: of the model.
        state: whose policy of the car is meant.
        x: of the road user, m.
        y: likewise.
        vx: of the road user in the tick before, m/s.
        vy: likewise.
        car_y: of the car's reference point, m.
        speed: of the car, m/s.
    """
    raise NotImplementedError(_UNBOUND)


def resume_car(parameters: Any, state: FloatArray, redrawn: FloatArray, rng: np.random.Generator) -> None:
    """Draw the car's speed anew, about that of a state that was believed, before the sensor places the car."""
    raise NotImplementedError(_UNBOUND)


def redraw_policy(parameters: Any, redrawn: FloatArray, rng: np.random.Generator) -> None:
    """Draw the car's policy anew, after the sensor has placed it."""
    raise NotImplementedError(_UNBOUND)


# --- the sensor's


def place_car(
    parameters: Any, state: FloatArray, observation: FloatArray, redrawn: FloatArray, rng: np.random.Generator
) -> None:
    """Place the car of a redrawn state where an observation says, give or take the sensor's noise.

    Args:
        parameters: of the model.
        state: what was believed.
        observation: as the sensor gives it.
        redrawn: holds the road user; the car's place is written.
        rng: for the noise.
    """
    raise NotImplementedError(_UNBOUND)


# --- the objective's


def begin(parameters: Any, state: FloatArray) -> None:
    """Write the objective's own part of a first state."""
    raise NotImplementedError(_UNBOUND)


# --- of all together (`crossing`)


def move(
    parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray, rng: np.random.Generator
) -> float:
    """Write road user and car of the next state; return the share of the step at which they touch, else infinity."""
    raise NotImplementedError(_UNBOUND)
