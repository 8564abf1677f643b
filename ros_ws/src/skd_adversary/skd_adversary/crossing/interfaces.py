"""What a template may call by name; the composer binds each to the part of the model at hand.

States are vectors as in `crossing`, velocities (East, North) in m/s, `parameters` those of the composed model.
"""

from __future__ import annotations

from typing import Any, Final, cast

import numpy as np
from skd_sim.arrays import FloatArray

_UNBOUND = "bound by the composer"
_NO_NUMBER = cast(int, None)  # with which no kernel compiles

USER_ROW: Final = _NO_NUMBER
"""Where the road user's own part of a state begins."""
ROW: Final = _NO_NUMBER
"""Where the objective's own part of a state begins."""
USER_DIM: Final = _NO_NUMBER
"""Length of the road user's own part of a state; 0: what it did before does not matter to what it can do."""
REST: Final = _NO_NUMBER
"""The action with which the road user stays where it is, or comes nearest to that."""
LATE_ACTIONS: Final = cast(tuple[int, ...], None)
"""Actions of the road user by one of which it meets a car that comes after φ has left its path."""
EARLY_ACTIONS: Final = cast(tuple[int, ...], None)
"""Actions by one of which it meets a car that has passed before φ gets there."""
AS_PHI: Final = _NO_NUMBER
"""The action *as φ*, one beyond the road user's own: φ's displacement in the present tick, none after its end, or what
of the `possible` comes nearest to that."""


# --- the road user's


def velocity(parameters: Any, state: FloatArray, action: int) -> tuple[float, float]:
    """Return the velocity under an action of the road user."""
    raise NotImplementedError(_UNBOUND)


def start_road_user(parameters: Any, state: FloatArray) -> None:
    """Write the adversary's own part of a first state."""
    raise NotImplementedError(_UNBOUND)


def settle(parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray) -> None:
    """Write the adversary's own part of the next state, after a step with a velocity."""
    raise NotImplementedError(_UNBOUND)


def possible(parameters: Any, state: FloatArray, vx: float, vy: float) -> tuple[float, float]:
    """Return what comes nearest to a wanted velocity of all that the road user can do from its state."""
    raise NotImplementedError(_UNBOUND)


def moving(parameters: Any, state: FloatArray) -> tuple[float, float]:
    """Return the velocity with which the road user came into a state; none of one that does as it likes at once."""
    raise NotImplementedError(_UNBOUND)


def next_velocity(parameters: Any, vx: float, vy: float, action: int) -> tuple[float, float]:
    """Return the velocity under an action of the road user in a tick before which it moved at (vx, vy), m/s."""
    raise NotImplementedError(_UNBOUND)


def next_possible(parameters: Any, vx: float, vy: float, wanted_x: float, wanted_y: float) -> tuple[float, float]:
    """Return what comes nearest to a wanted velocity of all that the road user can do after one of (vx, vy), m/s."""
    raise NotImplementedError(_UNBOUND)


def pointing(parameters: Any, state: FloatArray, vx: float, vy: float) -> float:
    """Return where the road user's body points (rad) while it moves with a velocity."""
    raise NotImplementedError(_UNBOUND)


def steer(parameters: Any, state: FloatArray, way: int) -> int:
    """Return the adversary's action that comes nearest to one of a pedestrian's; *as φ* is as φ for every kind.

    Default policies think in those: North, South, East, North-East, South-East, stay.
    """
    raise NotImplementedError(_UNBOUND)


def touch(parameters: Any, ahead: float, left: float, ahead_after: float, left_after: float, turned: float) -> float:
    """Return the share of a step at which the road user's body first touches the car's footprint, else infinity.

    Args:
        parameters: parameters of the model.
        ahead: how far the adversary's centre is ahead of the car's reference point when the step begins, m.
        left: how far its centre is to the left of that point then, m.
        ahead_after: how far its centre is ahead when the step ends, m.
        left_after: how far its centre is to the left when the step ends, m.
        turned: heading of its body relative to the car's, rad.
    """
    raise NotImplementedError(_UNBOUND)


# --- the road's


def on_road(parameters: Any, x: float, y: float) -> tuple[float, float]:
    """Return how far to the right of the road's centre line, and where along it, a point (x, y) is; m.

    In these coordinates every road is straight and leads North.
    """
    raise NotImplementedError(_UNBOUND)


def velocity_on_road(parameters: Any, x: float, y: float, vx: float, vy: float) -> tuple[float, float]:
    """Return the components of a velocity to the right of the road and along it, beside a point (x, y)."""
    raise NotImplementedError(_UNBOUND)


def from_car(parameters: Any, x: float, y: float, car_s: float) -> tuple[float, float]:
    """Return how far ahead and to the left of the car's reference point, at path coordinate s (m), a point is; m."""
    raise NotImplementedError(_UNBOUND)


def left_behind(parameters: Any, x: float, y: float, car_s: float) -> bool:
    """Return whether a point (x, y), m, is behind the car at path coordinate s (m), which will not turn back to it.

    The path coordinate alone does not say so: before a curve, who is beside the road on its inner side may be far
    behind the car, and be there before it by the short cut.
    """
    raise NotImplementedError(_UNBOUND)


def at_distance(parameters: Any, x: float, y: float, distance: float, behind: bool) -> float:
    """Return the path coordinate (m) at a distance (m) from a point (x, y), before it on the road or beyond it."""
    raise NotImplementedError(_UNBOUND)


def contact(
    parameters: Any,
    x: float,
    y: float,
    x_after: float,
    y_after: float,
    heading: float,
    car_s: float,
    car_s_after: float,
) -> float:
    """Return the share of a step at which road user and car first touch, else infinity; both move uniformly.

    Args:
        parameters: parameters of the model.
        x: place of the adversary to the East when the step begins, m.
        y: place of the adversary to the North when the step begins, m.
        x_after: place to the East when the step ends, m.
        y_after: place to the North when the step ends, m.
        heading: heading of its body, rad.
        car_s: path coordinate of the car's reference point when the step begins, m.
        car_s_after: path coordinate of the car's reference point when the step ends, m.
    """
    raise NotImplementedError(_UNBOUND)


# --- the predicted car's


def start_car(parameters: Any, state: FloatArray, rng: np.random.Generator) -> None:
    """Draw place, speed and policy of the car into a state of the initial belief."""
    raise NotImplementedError(_UNBOUND)


def advance_car(
    parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray, rng: np.random.Generator
) -> None:
    """Write all of the car's part of the next state, while the adversary moves with a velocity."""
    raise NotImplementedError(_UNBOUND)


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
    """Return what the car of a state will do (m/s²), its noise left aside, once it and the road user have moved.

    Args:
        parameters: parameters of the model.
        state: state whose policy of the car is asked.
        x: place of the adversary to the East, m.
        y: place of the adversary to the North, m.
        vx_before: velocity of the adversary to the East in the tick before, m/s.
        vy_before: velocity of the adversary to the North in the tick before, m/s.
        vx: velocity of the adversary to the East in the tick itself, m/s.
        vy: velocity of the adversary to the North in the tick itself, m/s.
        car_s: path coordinate of the car's reference point, m.
        speed: speed of the car, m/s.
        change: change of that speed in the last tick, m/s.
        change_before: change of that speed in the tick before the last, m/s.
    """
    raise NotImplementedError(_UNBOUND)


def last_changes(parameters: Any, state: FloatArray) -> tuple[float, float]:
    """Return by how much the car's speed changed in the last tick, and in the one before, m/s; 0 to who does not care.

    It begins what `foreseen_acceleration` is told.
    """
    raise NotImplementedError(_UNBOUND)


def resume_car(parameters: Any, state: FloatArray, redrawn: FloatArray, rng: np.random.Generator) -> None:
    """Draw the car's speed anew, near that of a state that was believed, before the sensor places the car."""
    raise NotImplementedError(_UNBOUND)


def redraw_policy(parameters: Any, redrawn: FloatArray, rng: np.random.Generator) -> None:
    """Draw the car's policy anew, after the sensor has placed it."""
    raise NotImplementedError(_UNBOUND)


# --- the sensor's


def place_car(
    parameters: Any, state: FloatArray, observation: FloatArray, redrawn: FloatArray, rng: np.random.Generator
) -> None:
    """Place the car of a redrawn state where an observation says, with the sensor's noise.

    Args:
        parameters: parameters of the model.
        state: state that was believed before.
        observation: observation as the sensor gives it.
        redrawn: state that holds the adversary's own part already; the car's place is written into it.
        rng: generator of the noise.
    """
    raise NotImplementedError(_UNBOUND)


# --- the objective's


def chosen(parameters: Any, state: FloatArray, action: int) -> tuple[float, float]:
    """Return the velocity under an action: one of the road user's, or *as φ*, if the objective has that."""
    raise NotImplementedError(_UNBOUND)


def sensible(parameters: Any, state: FloatArray, vx: float, vy: float) -> bool:
    """Return whether it makes sense to move with a velocity that the road user can have."""
    raise NotImplementedError(_UNBOUND)


def begin(parameters: Any, state: FloatArray) -> None:
    """Write the objective's own part of a first state."""
    raise NotImplementedError(_UNBOUND)


# --- of all together (`crossing`)


def move(
    parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray, rng: np.random.Generator
) -> float:
    """Write adversary and car of the next state; return the share of the step at which they touch, else infinity."""
    raise NotImplementedError(_UNBOUND)
