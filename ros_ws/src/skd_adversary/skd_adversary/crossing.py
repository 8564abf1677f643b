"""What the safe and the kamikaze POMDP of the crossing share: state, actions, transition and sensors.

State (paper, "Generating Kamikaze Trajectories"): pedestrian × predicted car × parameters of the car's policy. The
predicted car drives North on x = 0 by the basic policy, with velocity noise and without acceleration noise
(paper, "Kamikaze Trajectories": "it only models the velocity uncertainty").
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from skd_sim.compilation import kernel
from skd_sim.controllers import basic_acceleration
from skd_sim.geometry import first_contact
from skd_sim.motion import draw_relative, next_speed, travelled
from skd_sim.scenario import Scenario

from skd_adversary.car_model import CarModel
from skd_adversary.pomdp import FloatArray, Pomdp

# State vector
PEDESTRIAN_X, PEDESTRIAN_Y, CAR_Y, CAR_SPEED, TRIGGER = range(5)
STATE_DIM = 5

# Actions, in the order of the paper, section "Safe Trajectories"
NORTH, SOUTH, EAST, NORTH_EAST, SOUTH_EAST, STAY = range(6)
ACTION_COUNT = 6
_DIAGONAL = math.sqrt(0.5)
DIRECTION_EAST = (0.0, 0.0, 1.0, _DIAGONAL, _DIAGONAL, 0.0)
DIRECTION_NORTH = (1.0, -1.0, 0.0, _DIAGONAL, -_DIAGONAL, 0.0)


class CrossingParameters(NamedTuple):
    """Parameters of the crossing POMDPs; lengths in m, speeds in m/s, times in s."""

    time_step: float
    front: float
    rear: float
    half_width: float
    radius: float
    pedestrian_speed: float
    start_x: float
    start_y: float
    destination_x: float
    car_start_low: float  # y of the car's reference point, lower end of the start range
    car_start_high: float
    car_start_speed: float
    deceleration: float
    speed_noise: float
    trigger_low: float  # C·κ: range of the prior; one point where C is known
    trigger_high: float
    position_noise: float
    distance_noise: float
    collision_reward: float
    destination_reward: float
    step_reward: float
    distance_weight: float  # per metre from φ and step
    path: FloatArray  # φ, n × 2


@kernel
def action_velocity(action: int, speed: float) -> tuple[float, float]:
    """Return the pedestrian's velocity (East, North), m/s, under an action."""
    return speed * DIRECTION_EAST[action], speed * DIRECTION_NORTH[action]


@kernel
def initial_state(parameters: CrossingParameters, state: FloatArray, rng: np.random.Generator) -> None:
    """Draw a state from the initial belief: the pedestrian is known, start and policy of the car are not."""
    p = parameters
    state[PEDESTRIAN_X] = p.start_x
    state[PEDESTRIAN_Y] = p.start_y
    state[CAR_Y] = p.car_start_low + (p.car_start_high - p.car_start_low) * rng.random()
    state[CAR_SPEED] = p.car_start_speed
    state[TRIGGER] = p.trigger_low + (p.trigger_high - p.trigger_low) * rng.random()


@kernel
def transition(
    parameters: CrossingParameters,
    state: FloatArray,
    action: int,
    next_state: FloatArray,
    rng: np.random.Generator,
) -> bool:
    """Write the next state and return whether car and pedestrian touch on the way to it."""
    p = parameters
    vx, vy = action_velocity(action, p.pedestrian_speed)
    x, y = state[PEDESTRIAN_X], state[PEDESTRIAN_Y]
    x_after, y_after = x + p.time_step * vx, y + p.time_step * vy
    car_y, speed = state[CAR_Y], state[CAR_SPEED]
    acceleration = basic_acceleration(y - car_y - p.front, state[TRIGGER], p.deceleration)
    speed_after = next_speed(speed, acceleration, draw_relative(p.speed_noise, rng), p.time_step)
    car_y_after = car_y + travelled(speed, speed_after, p.time_step)
    next_state[PEDESTRIAN_X] = x_after
    next_state[PEDESTRIAN_Y] = y_after
    next_state[CAR_Y] = car_y_after
    next_state[CAR_SPEED] = speed_after
    next_state[TRIGGER] = state[TRIGGER]
    # Far away, which is most of the time, the swept test need not be made.
    margin = p.radius + p.half_width
    if (x < -margin and x_after < -margin) or (x > margin and x_after > margin):
        return False
    if y - car_y > p.front + p.radius and y_after - car_y_after > p.front + p.radius:
        return False
    fraction = first_contact(y - car_y, -x, y_after - car_y_after, -x_after, p.front, p.rear, p.half_width, p.radius)
    return fraction <= 1.0


@kernel
def observe_relative_position(
    parameters: CrossingParameters,
    state: FloatArray,
    action: int,
    observation: FloatArray,
    rng: np.random.Generator,
) -> None:
    """Draw the car's position relative to the pedestrian (East, North), m, with Gaussian noise per axis."""
    observation[0] = -state[PEDESTRIAN_X] + parameters.position_noise * rng.standard_normal()
    observation[1] = state[CAR_Y] - state[PEDESTRIAN_Y] + parameters.position_noise * rng.standard_normal()


@kernel
def relative_position_likelihood(
    parameters: CrossingParameters, state: FloatArray, action: int, observation: FloatArray
) -> float:
    """Return the density, up to a factor, of an observed relative position (m)."""
    error_x = (observation[0] + state[PEDESTRIAN_X]) / parameters.position_noise
    error_y = (observation[1] - state[CAR_Y] + state[PEDESTRIAN_Y]) / parameters.position_noise
    return math.exp(-0.5 * (error_x * error_x + error_y * error_y))


@kernel
def _distance(state: FloatArray) -> float:
    dx, dy = state[PEDESTRIAN_X], state[CAR_Y] - state[PEDESTRIAN_Y]
    return math.sqrt(dx * dx + dy * dy)


@kernel
def observe_distance(
    parameters: CrossingParameters,
    state: FloatArray,
    action: int,
    observation: FloatArray,
    rng: np.random.Generator,
) -> None:
    """Draw the distance between pedestrian and car, m, with Gaussian noise."""
    observation[0] = _distance(state) + parameters.distance_noise * rng.standard_normal()


@kernel
def distance_likelihood(
    parameters: CrossingParameters, state: FloatArray, action: int, observation: FloatArray
) -> float:
    """Return the density, up to a factor, of an observed distance (m)."""
    error = (observation[0] - _distance(state)) / parameters.distance_noise
    return math.exp(-0.5 * error * error)


@kernel
def _redraw_policy(
    parameters: CrossingParameters, state: FloatArray, redrawn: FloatArray, rng: np.random.Generator
) -> None:
    """Keep the pedestrian, which is known for sure, and draw speed and policy of the car anew."""
    p = parameters
    redrawn[PEDESTRIAN_X] = state[PEDESTRIAN_X]
    redrawn[PEDESTRIAN_Y] = state[PEDESTRIAN_Y]
    redrawn[CAR_SPEED] = p.car_start_speed * rng.random()
    redrawn[TRIGGER] = p.trigger_low + (p.trigger_high - p.trigger_low) * rng.random()


@kernel
def reinvigorate_relative_position(
    parameters: CrossingParameters,
    state: FloatArray,
    observation: FloatArray,
    redrawn: FloatArray,
    rng: np.random.Generator,
) -> None:
    """Draw a car where the observed relative position says, give or take the sensor's noise."""
    _redraw_policy(parameters, state, redrawn, rng)
    noise = parameters.position_noise * rng.standard_normal()
    redrawn[CAR_Y] = state[PEDESTRIAN_Y] + observation[1] + noise


@kernel
def reinvigorate_distance(
    parameters: CrossingParameters,
    state: FloatArray,
    observation: FloatArray,
    redrawn: FloatArray,
    rng: np.random.Generator,
) -> None:
    """Draw a car at the observed distance, give or take the sensor's noise, on the side where it was believed."""
    _redraw_policy(parameters, state, redrawn, rng)
    distance = observation[0] + parameters.distance_noise * rng.standard_normal()
    x = state[PEDESTRIAN_X]
    along = math.sqrt(max(0.0, distance * distance - x * x))
    behind = state[CAR_Y] <= state[PEDESTRIAN_Y]
    redrawn[CAR_Y] = state[PEDESTRIAN_Y] - along if behind else state[PEDESTRIAN_Y] + along


@kernel
def polyline_distance(x: float, y: float, path: FloatArray) -> float:
    """Return the distance (m) from (x, y) to the polyline through the rows of `path` (n × 2, m)."""
    best = math.inf
    if path.shape[0] == 1:
        return math.sqrt((x - path[0, 0]) ** 2 + (y - path[0, 1]) ** 2)
    for i in range(path.shape[0] - 1):
        ax, ay = path[i, 0], path[i, 1]
        bx, by = path[i + 1, 0] - ax, path[i + 1, 1] - ay
        px, py = x - ax, y - ay
        length2 = bx * bx + by * by
        s = 0.0 if length2 == 0.0 else min(1.0, max(0.0, (px * bx + py * by) / length2))
        dx, dy = px - s * bx, py - s * by
        best = min(best, dx * dx + dy * dy)
    return math.sqrt(best)


def crossing_parameters(
    scenario: Scenario,
    car_model: CarModel,
    *,
    start: tuple[float, float],
    gap: float,
    rewards: Mapping[str, float],
    path: FloatArray,
) -> CrossingParameters:
    """Collect the parameters of a crossing POMDP.

    Args:
        scenario: fixed description of the test.
        car_model: what the adversary thinks of the car.
        start: the pedestrian's start (x, y), m.
        gap: front bumper to the crossing line before the episode's draw, m.
        rewards: collision_reward, destination_reward, step_reward and distance_weight; 0 where absent.
        path: φ, n × 2, m; one row where there is none.
    """
    car, walker = scenario.car, scenario.pedestrian
    nearest = -gap - car.front
    return CrossingParameters(
        time_step=scenario.time_step,
        front=car.front,
        rear=car.rear,
        half_width=car.half_width,
        radius=walker.radius,
        pedestrian_speed=walker.speed,
        start_x=float(start[0]),
        start_y=float(start[1]),
        destination_x=walker.destination_x,
        car_start_low=nearest - car.start_gap_range,
        car_start_high=nearest,
        car_start_speed=car.start_speed,
        deceleration=car.deceleration,
        speed_noise=car.speed_noise,
        trigger_low=car_model.multiplier_low * car.safe_distance,
        trigger_high=car_model.multiplier_high * car.safe_distance,
        position_noise=walker.position_noise,
        distance_noise=walker.distance_noise,
        collision_reward=rewards.get("collision_reward", 0.0),
        destination_reward=rewards.get("destination_reward", 0.0),
        step_reward=rewards.get("step_reward", 0.0),
        distance_weight=rewards.get("distance_weight", 0.0),
        path=np.array(path, dtype=np.float64, order="C"),  # a copy: one type for kernels, read-only or not
    )


def crossing_pomdp(
    name: str,
    parameters: CrossingParameters,
    car_model: CarModel,
    *,
    discount: float,
    step: Callable[..., tuple[float, bool]],
    rollout_action: Callable[..., int],
) -> Pomdp:
    """Put a crossing POMDP together: what differs is the reward, in `step`, and the sensor, by the car model."""
    if car_model.observes_position:
        sensor: dict[str, Any] = {
            "name": f"{name}_position",
            "observation_dim": 2,
            "observe": observe_relative_position,
            "likelihood": relative_position_likelihood,
            "reinvigorate": reinvigorate_relative_position,
        }
    else:
        sensor = {
            "name": f"{name}_distance",
            "observation_dim": 1,
            "observe": observe_distance,
            "likelihood": distance_likelihood,
            "reinvigorate": reinvigorate_distance,
        }
    return Pomdp(
        state_dim=STATE_DIM,
        action_count=ACTION_COUNT,
        discount=discount,
        parameters=parameters,
        initial=initial_state,
        step=step,
        rollout_action=rollout_action,
        **sensor,
    )
