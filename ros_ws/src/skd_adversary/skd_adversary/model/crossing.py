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
from skd_sim.geometry import first_contact, rectangle_distance
from skd_sim.motion import draw_relative, next_speed, travelled
from skd_sim.scenario import Scenario

from skd_adversary.model.car.basic import CarModel
from skd_adversary.planning.pomdp import FloatArray, Pomdp

# State vector
PEDESTRIAN_X, PEDESTRIAN_Y, CAR_Y, CAR_SPEED, TRIGGER = range(5)
STATE_DIM = 5

# Actions, in the order of the paper, section "Safe Trajectories"
NORTH, SOUTH, EAST, NORTH_EAST, SOUTH_EAST, STAY = range(6)
ACTION_COUNT = 6
AS_PHI = 6
"""As φ (objective `deformation` only): the displacement that φ makes in the present tick, none after its end."""
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
    maximum_distance: float  # from φ; ∞ where there is none
    path: FloatArray  # φ, n × 2
    segments: FloatArray  # φ as `polyline_segments`


@kernel(inline=True)
def action_velocity(action: int, speed: float) -> tuple[float, float]:
    """Return the pedestrian's velocity (East, North), m/s, under an action."""
    return speed * DIRECTION_EAST[action], speed * DIRECTION_NORTH[action]


@kernel(inline=True)
def path_velocity(path: FloatArray, tick: int, time_step: float) -> tuple[float, float]:
    """Return φ's own velocity (East, North), m/s, from a tick to the next: that of `AS_PHI`.

    Args:
        path: φ, n × 2, m.
        tick: ≥ 0; from n − 1 on φ stands still.
        time_step: s.
    """
    if tick + 1 >= path.shape[0]:
        return 0.0, 0.0
    return (path[tick + 1, 0] - path[tick, 0]) / time_step, (path[tick + 1, 1] - path[tick, 1]) / time_step


@kernel
def initial_state(parameters: CrossingParameters, state: FloatArray, rng: np.random.Generator) -> None:
    """Draw a state from the initial belief: the pedestrian is known, start and policy of the car are not."""
    p = parameters
    state[PEDESTRIAN_X] = p.start_x
    state[PEDESTRIAN_Y] = p.start_y
    state[CAR_Y] = p.car_start_low + (p.car_start_high - p.car_start_low) * rng.random()
    state[CAR_SPEED] = p.car_start_speed
    state[TRIGGER] = p.trigger_low + (p.trigger_high - p.trigger_low) * rng.random()


@kernel(inline=True)
def transition(
    parameters: CrossingParameters,
    state: FloatArray,
    action: int,
    next_state: FloatArray,
    rng: np.random.Generator,
) -> float:
    """Write the next state and return the fraction of the step at which car and pedestrian touch, else infinity."""
    vx, vy = action_velocity(action, parameters.pedestrian_speed)
    return move(parameters, state, vx, vy, next_state, rng)


@kernel(inline=True)
def move(
    parameters: CrossingParameters,
    state: FloatArray,
    vx: float,
    vy: float,
    next_state: FloatArray,
    rng: np.random.Generator,
) -> float:
    """As `transition`, of a pedestrian that moves with a velocity (East, North), m/s."""
    p = parameters
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
        return math.inf
    if y - car_y > p.front + p.radius and y_after - car_y_after > p.front + p.radius:
        return math.inf
    return first_contact(y - car_y, -x, y_after - car_y_after, -x_after, p.front, p.rear, p.half_width, p.radius)


@kernel(inline=True)
def foreseen_acceleration(
    parameters: CrossingParameters,
    state: FloatArray,
    x: float,
    y: float,
    vx: float,
    vy: float,
    car_y: float,
    speed: float,
) -> float:
    """Return what the car of a state will do (m/s²), its noise left aside, once it and the pedestrian have moved.

    Args:
        parameters: of the model.
        state: whose policy of the car is meant.
        x: of the pedestrian, m.
        y: likewise.
        vx: of the pedestrian in the tick before, m/s.
        vy: likewise.
        car_y: of the car's reference point, m.
        speed: of the car, m/s.
    """
    return basic_acceleration(y - car_y - parameters.front, state[TRIGGER], parameters.deceleration)


@kernel(inline=True)
def observe_relative_position(
    parameters: CrossingParameters,
    state: FloatArray,
    action: int,
    observation: FloatArray,
    rng: np.random.Generator,
) -> None:
    """Draw how far North of the pedestrian the car's reference point is seen, m, with Gaussian noise.

    The East component of the relative position says nothing that is not known, the pedestrian's own x: its likelihood
    is the same for every state, so the model goes without it.
    """
    observation[0] = state[CAR_Y] - state[PEDESTRIAN_Y] + parameters.position_noise * rng.standard_normal()


@kernel
def relative_position_likelihood(
    parameters: CrossingParameters, state: FloatArray, action: int, observation: FloatArray
) -> float:
    """Return the density, up to a factor, of an observed North component of the relative position (m)."""
    error = (observation[0] - state[CAR_Y] + state[PEDESTRIAN_Y]) / parameters.position_noise
    return math.exp(-0.5 * error * error)


@kernel(inline=True)
def _distance(state: FloatArray) -> float:
    dx, dy = state[PEDESTRIAN_X], state[CAR_Y] - state[PEDESTRIAN_Y]
    return math.sqrt(dx * dx + dy * dy)


@kernel(inline=True)
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
    """Keep the pedestrian and what a model's state has of its own, known for sure; draw the car's policy anew."""
    p = parameters
    redrawn[STATE_DIM:] = state[STATE_DIM:]
    redrawn[PEDESTRIAN_X] = state[PEDESTRIAN_X]
    redrawn[PEDESTRIAN_Y] = state[PEDESTRIAN_Y]
    redrawn[CAR_SPEED] = state[CAR_SPEED] if rng.random() < 0.8 else p.car_start_speed * rng.random()
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
    p = parameters
    _redraw_policy(parameters, state, redrawn, rng)
    for _ in range(20):
        noise = parameters.position_noise * rng.standard_normal()
        redrawn[CAR_Y] = state[PEDESTRIAN_Y] + observation[0] + noise
        ahead, left = state[PEDESTRIAN_Y] - redrawn[CAR_Y], -state[PEDESTRIAN_X]
        if rectangle_distance(ahead, left, p.front, p.rear, p.half_width) > p.radius:
            break


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


def crossing_parameters(
    scenario: Scenario,
    car_model: CarModel,
    *,
    start: tuple[float, float],
    gap: float,
    rewards: Mapping[str, float],
    path: FloatArray,
    maximum_distance: float | None = None,
) -> CrossingParameters:
    """Collect the parameters of a crossing POMDP.

    Args:
        scenario: fixed description of the test.
        car_model: what the adversary thinks of the car.
        start: the pedestrian's start (x, y), m.
        gap: front bumper to the crossing line before the episode's draw, m.
        rewards: collision_reward, destination_reward, step_reward and distance_weight; 0 where absent.
        path: φ, n × 2, m; one row where there is none.
        maximum_distance: from φ, m; none by default.
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
        maximum_distance=math.inf if maximum_distance is None else maximum_distance,
        path=np.array(path, dtype=np.float64, order="C"),  # a copy: one type for kernels, read-only or not
        segments=polyline_segments(np.asarray(path, dtype=np.float64)),
    )


def crossing_pomdp(
    name: str,
    parameters: CrossingParameters,
    car_model: CarModel,
    *,
    discount: float,
    step: Callable[..., tuple[float, bool]],
    rollout_action: Callable[..., int],
    **others: Any,
) -> Pomdp:
    """Put a crossing POMDP together: what differs is the reward, in `step`, and the sensor, by the car model.

    Args:
        name: of the model, before its sensor.
        parameters: of the crossing.
        car_model: what the adversary thinks of the car.
        discount: γ.
        step: as in `Pomdp`.
        rollout_action: as in `Pomdp`.
        others: fields of `Pomdp` that differ from the crossing's own.
    """
    if car_model.observes_position:
        sensor: dict[str, Any] = {
            "name": f"{name}_position",
            "observe": observe_relative_position,
            "likelihood": relative_position_likelihood,
            "reinvigorate": reinvigorate_relative_position,
        }
    else:
        sensor = {
            "name": f"{name}_distance",
            "observe": observe_distance,
            "likelihood": distance_likelihood,
            "reinvigorate": reinvigorate_distance,
        }
    crossing: dict[str, Any] = {
        "state_dim": STATE_DIM,
        "action_count": ACTION_COUNT,
        "initial": initial_state,
        **sensor,
        **others,
    }
    return Pomdp(
        observation_dim=1,
        discount=discount,
        parameters=parameters,
        step=step,
        rollout_action=rollout_action,
        **crossing,
    )
