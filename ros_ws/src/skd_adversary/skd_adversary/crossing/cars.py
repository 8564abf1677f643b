"""How the adversary predicts the car, the basic one or one from logs, and what it sees of it, with Gaussian noise.

*Sensors.* The distance is what is seen of a car of which nothing is known, the relative position what is seen of a
basic car (paper, "Kamikaze Trajectories"). The component across the road says nothing that is not known, the road
user's own place: its likelihood is the same for every state, so the model goes without it. On a curved road the place
that was seen is put on the centre line. Of a car that evades the component across the road and its heading are seen,
too.

*Basic.* The car follows the basic policy with an unknown or known multiplier; what is unknown is a prior, carried as a
state variable by the belief. It has velocity noise and no acceleration noise (paper, "Kamikaze Trajectories": "it only
models the velocity uncertainty").

*Learned, by a law.* What the fit leaves uncertain is part of the state: each of its parameters is drawn from its prior
in the initial belief and carried along, so that the belief learns it.

*Learned, by a forest* (`car_models.forest`), where no law fits. In each tick a tree is drawn, then a donor in the leaf
to which the tick's features lead: the car does what it did then. What the default policy expects is one tree's
opinion, the same tree as long as a state lives: its leaf's median. Where the car evades, the donors also say how far
to the side it goes and where it points then, and the adversary sees the car's whole pose.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from skd_sim.controllers.basic import basic_acceleration
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.road import road_pose, road_position
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import rectangle_distance
from skd_sim.world.state import CarState, FloatArray, Pair, Triple, draw_relative, next_speed, travelled

from skd_adversary.car_models.car_model_file import LONGEST_DELAY, FittedCar
from skd_adversary.car_models.forest import features_of, leaf_of
from skd_adversary.crossing.interfaces import (
    ADVERSARY_X,
    ADVERSARY_Y,
    CAR_S,
    CAR_SPEED,
    OFFSET,
    STATE_DIM,
    TRIGGER,
    TURNED,
    CarKernels,
    SensorModel,
    at_distance,
    from_car,
    on_road,
    template,
    velocity_on_road,
)

# --- sensors


@template
def _distance(parameters: Any, state: FloatArray) -> float:
    ahead, left = from_car(parameters, state[ADVERSARY_X], state[ADVERSARY_Y], state[CAR_S])
    return math.sqrt(left * left + ahead * ahead)


class _Distance(SensorModel):
    """A sensor of the distance to the car."""

    name = "distance"

    @staticmethod
    def sense(scenario: Scenario, own: Pair, car: CarState, rng: np.random.Generator) -> FloatArray:
        """Return the distance at which the car is seen, m; places are (x, y), m."""
        dx, dy = car.x - own[0], car.y - own[1]
        distance = math.sqrt(dx * dx + dy * dy)
        return np.array([distance + scenario.adversary.distance_noise * rng.standard_normal()])

    @template
    def observe(
        parameters: Any, state: FloatArray, action: int, observation: FloatArray, rng: np.random.Generator
    ) -> None:
        """Draw the observed distance between road user and car, m."""
        observation[0] = _distance(parameters, state) + parameters.distance_noise * rng.standard_normal()

    @template(inline=False)
    def likelihood(parameters: Any, state: FloatArray, action: int, observation: FloatArray) -> float:
        """Return the density, up to a factor, of an observed distance (m)."""
        error = (observation[0] - _distance(parameters, state)) / parameters.distance_noise
        return math.exp(-0.5 * error * error)

    @template(inline=False)
    def place_car(
        parameters: Any, state: FloatArray, observation: FloatArray, redrawn: FloatArray, rng: np.random.Generator
    ) -> None:
        """Interface `place_car`: at the observed distance, on the side where the car was believed."""
        distance = observation[0] + parameters.distance_noise * rng.standard_normal()
        x, y = state[ADVERSARY_X], state[ADVERSARY_Y]
        _, along = on_road(parameters, x, y)
        redrawn[CAR_S] = at_distance(parameters, x, y, distance, state[CAR_S] <= along)


DISTANCE = _Distance


class _Position(SensorModel):
    """A sensor of the car's relative position along the road."""

    name = "position"

    @staticmethod
    def sense(scenario: Scenario, own: Pair, car: CarState, rng: np.random.Generator) -> FloatArray:
        """Return how far beyond the road user, along the road, the car is seen, m; places are (x, y), m."""
        noise = scenario.adversary.position_noise * rng.standard_normal(2)  # of both components
        if scenario.road.straight:
            return np.array([car.y - own[1] + noise[1]])
        line = scenario.road.line
        return np.array([road_position(line, car.x + noise[0], car.y + noise[1])[0] - road_position(line, *own)[0]])

    @template
    def observe(
        parameters: Any, state: FloatArray, action: int, observation: FloatArray, rng: np.random.Generator
    ) -> None:
        """Draw how far beyond the road user the car's reference point is seen, m."""
        _, along = on_road(parameters, state[ADVERSARY_X], state[ADVERSARY_Y])
        observation[0] = state[CAR_S] - along + parameters.position_noise * rng.standard_normal()

    @template(inline=False)
    def likelihood(parameters: Any, state: FloatArray, action: int, observation: FloatArray) -> float:
        """Return the density, up to a factor, of an observed relative position along the road (m)."""
        _, along = on_road(parameters, state[ADVERSARY_X], state[ADVERSARY_Y])
        error = (observation[0] - state[CAR_S] + along) / parameters.position_noise
        return math.exp(-0.5 * error * error)

    @template(inline=False)
    def place_car(
        parameters: Any, state: FloatArray, observation: FloatArray, redrawn: FloatArray, rng: np.random.Generator
    ) -> None:
        """Interface `place_car`: where the observed relative position says; not upon the road user."""
        p = parameters
        x, y = state[ADVERSARY_X], state[ADVERSARY_Y]
        _, along = on_road(p, x, y)
        for _ in range(20):
            noise = parameters.position_noise * rng.standard_normal()
            redrawn[CAR_S] = along + observation[0] + noise
            ahead, left = from_car(p, x, y, redrawn[CAR_S])
            if rectangle_distance(ahead, left, p.front, p.rear, p.half_width) > p.radius:
                break


RELATIVE_POSITION = _Position


_HEADING_NOISE: Final = 0.1  # rad


@template
def _pose_expected(parameters: Any, state: FloatArray) -> Triple:
    """Return what is seen of the car of a state, without noise."""
    across, along = on_road(parameters, state[ADVERSARY_X], state[ADVERSARY_Y])
    return state[CAR_S] - along, state[OFFSET] - across, state[TURNED]


class _Pose(_Position):
    """A sensor of the place of a car that evades, along the road and across it, and of its heading."""

    name, observation_dim = "pose", 3

    @staticmethod
    def sense(scenario: Scenario, own: Pair, car: CarState, rng: np.random.Generator) -> FloatArray:
        """Return how far beyond the road user and to its right the car is seen, m, and turned to the right, rad."""
        line, noise = scenario.road.line, scenario.adversary.position_noise
        (along, left), (own_along, own_left) = road_position(line, car.x, car.y), road_position(line, *own)
        turned = math.remainder(road_pose(line, along)[2] - car.heading, math.tau)
        exact = np.array([along - own_along, own_left - left, turned])
        return exact + np.array([noise, noise, _HEADING_NOISE]) * rng.standard_normal(3)

    @template
    def observe(
        parameters: Any, state: FloatArray, action: int, observation: FloatArray, rng: np.random.Generator
    ) -> None:
        """Draw what is seen of the car: see `_pose_sense`."""
        along, aside, turned = _pose_expected(parameters, state)
        observation[0] = along + parameters.position_noise * rng.standard_normal()
        observation[1] = aside + parameters.position_noise * rng.standard_normal()
        observation[2] = turned + _HEADING_NOISE * rng.standard_normal()

    @template(inline=False)
    def likelihood(parameters: Any, state: FloatArray, action: int, observation: FloatArray) -> float:
        """Return the density, up to a factor, of what is seen of the car."""
        along, aside, turned = _pose_expected(parameters, state)
        error = (observation[0] - along) / parameters.position_noise
        error_aside = (observation[1] - aside) / parameters.position_noise
        error_turned = (observation[2] - turned) / _HEADING_NOISE
        return math.exp(-0.5 * (error * error + error_aside * error_aside + error_turned * error_turned))


POSE = _Pose


# --- the basic car


@kernel
def _basic_start_car(parameters: Any, state: FloatArray, rng: np.random.Generator) -> None:
    """Interface `start_car`."""
    p = parameters
    state[CAR_S] = p.car_start_low + (p.car_start_high - p.car_start_low) * rng.random()
    state[CAR_SPEED] = p.car_start_speed
    state[TRIGGER] = p.trigger_low + (p.trigger_high - p.trigger_low) * rng.random()


class _Basic(CarKernels):
    """The basic car."""

    name, own_dim = "basic", 0

    @template
    def advance_car(
        parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray, rng: np.random.Generator
    ) -> None:
        """Interface `advance_car`."""
        p = parameters
        car_s, speed = state[CAR_S], state[CAR_SPEED]
        _, along = on_road(p, state[ADVERSARY_X], state[ADVERSARY_Y])
        acceleration = basic_acceleration(along - car_s - p.front, state[TRIGGER], p.deceleration)
        speed_after = next_speed(speed, acceleration, draw_relative(p.speed_noise, rng), p.time_step)
        next_state[CAR_S] = car_s + travelled(speed, speed_after, p.time_step)
        next_state[CAR_SPEED] = speed_after
        next_state[TRIGGER] = state[TRIGGER]

    @template
    def expected_motion(
        parameters: Any, state: FloatArray, place: Pair, before: Pair, now: Pair, car: Triple, changes: Triple
    ) -> Triple:
        """Interface `expected_motion`."""
        _, along = on_road(parameters, place[0], place[1])
        return basic_acceleration(along - car[0] - parameters.front, state[TRIGGER], parameters.deceleration), 0.0, 0.0

    @kernel
    def resume_car(parameters: Any, state: FloatArray, redrawn: FloatArray, rng: np.random.Generator) -> None:
        """Interface `resume_car`; the trigger, too."""
        p = parameters
        redrawn[CAR_SPEED] = state[CAR_SPEED] if rng.random() < 0.8 else p.car_start_speed * rng.random()
        redrawn[TRIGGER] = p.trigger_low + (p.trigger_high - p.trigger_low) * rng.random()

    @kernel
    def redraw_policy(parameters: Any, redrawn: FloatArray, rng: np.random.Generator) -> None:
        """Interface `redraw_policy`: the trigger has been drawn already."""

    @kernel(inline=True)
    def last_changes(parameters: Any, state: FloatArray) -> Triple:
        """Interface `last_changes`: of no matter to a car that has a law."""
        return 0.0, 0.0, 0.0

    @kernel(inline=True)
    def aside(parameters: Any, state: FloatArray) -> Pair:
        """Interface `aside`: it keeps to its lane."""
        return 0.0, 0.0

    start_car = _basic_start_car


BASIC_KERNELS = _Basic

WAITING_REWARD: Final = -0.08
"""m of deviation, for each step after φ's end: what it costs to wait for a car that stops by a law, which does not
come any more, though to look at it once more always seems to pay a little."""


@dataclass(frozen=True)
class CarModel:
    """Predicted policy of the car: brake within C·κ, with C ~ U[multiplier_low, multiplier_high].

    Attributes:
        multiplier_low: least C that the adversary thinks possible.
        multiplier_high: greatest C that it thinks possible; equal to the least where C is known.
        observes_position: whether the adversary senses the relative position (basic car) or the distance only.
    """

    multiplier_low: float
    multiplier_high: float
    observes_position: bool
    kernels = BASIC_KERNELS

    @property
    def sensor(self) -> type[SensorModel]:
        """Sensor by which the adversary sees the car."""
        return RELATIVE_POSITION if self.observes_position else DISTANCE

    def parameters(self, scenario: Scenario) -> Mapping[str, Any]:
        """Return noise (relative) and range of the trigger, m: one point where C is known."""
        car = scenario.car
        return {
            "speed_noise": car.speed_noise,
            "trigger_low": self.multiplier_low * car.safe_distance,
            "trigger_high": self.multiplier_high * car.safe_distance,
            "waiting_reward": WAITING_REWARD,
            "evades": False,
        }


def known_basic_car(multiplier: float) -> CarModel:
    """Return the model of a basic car whose C the adversary knows (paper, "Kamikaze Trajectories")."""
    return CarModel(multiplier, multiplier, observes_position=True)


def unknown_car() -> CarModel:
    """Return the model of a car of which nothing is known: C anywhere over and around the paper's range."""
    return CarModel(0.25, 1.5, observes_position=False)


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
def _fitted_redraw_policy(parameters: Any, redrawn: FloatArray, rng: np.random.Generator) -> None:
    """Interface `redraw_policy`: draw what is not known; it has decided nothing yet."""
    p = parameters
    trigger = _drawn(p.priors, _TRIGGER, rng)
    if p.spread_kind == 1.0:
        trigger = max(0.0, trigger + p.spread * rng.standard_normal())
    redrawn[TRIGGER] = trigger
    redrawn[PATH] = _drawn(p.priors, _PATH, rng)
    redrawn[DECELERATION] = _drawn(p.priors, _DECELERATION, rng)
    redrawn[DELAY] = min(float(LONGEST_DELAY), float(round(_drawn(p.priors, _DELAY, rng) / p.time_step)))
    redrawn[CRUISE] = _drawn(p.priors, _CRUISE, rng)
    redrawn[GAIN] = _drawn(p.priors, _GAIN, rng)
    redrawn[LIMIT] = _drawn(p.priors, _LIMIT, rng)
    redrawn[SPEED_NOISE] = _drawn(p.priors, _SPEED_NOISE, rng)
    for tick in range(LONGEST_DELAY):
        redrawn[MEMORY + tick] = 0.0


@template(inline=False)
def _in_reach(parameters: Any, trigger: float, path: float, place: Pair, velocity: Pair, car: Pair) -> bool:
    """Return whether an adversary makes the car brake; `car` is its place and speed, all in m and m/s."""
    p = parameters
    x, y = place
    car_s, speed = car
    across, along = on_road(p, x, y)
    v_across, v_along = velocity_on_road(p, x, y, velocity[0], velocity[1])
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


@template(inline=False)
def _brakes(parameters: Any, state: FloatArray, rng: np.random.Generator) -> bool:
    """Return whether the car decides to brake; the measures and paths of `car_fit.families`."""
    p = parameters
    trigger = state[TRIGGER]
    if p.spread_kind == 2.0:
        u = rng.random()
        trigger += p.spread * math.log((u + 1e-12) / (1.0 - u + 1e-12))
    place = state[ADVERSARY_X], state[ADVERSARY_Y]
    velocity = state[ADVERSARY_VX], state[ADVERSARY_VY]
    return bool(_in_reach(p, trigger, state[PATH], place, velocity, (state[CAR_S], state[CAR_SPEED])))


class _Fitted(_Basic):
    """A car that follows a law."""

    name, own_dim = "fitted", FITTED_STATE_DIM - STATE_DIM

    @kernel
    def start_car(parameters: Any, state: FloatArray, rng: np.random.Generator) -> None:
        """Interface `start_car`: where the basic car starts."""
        _basic_start_car(parameters, state, rng)
        state[ADVERSARY_VX] = 0.0
        state[ADVERSARY_VY] = 0.0
        _fitted_redraw_policy(parameters, state, rng)

    @template(inline=False)
    def expected_motion(
        parameters: Any, state: FloatArray, place: Pair, before: Pair, now: Pair, car: Triple, changes: Triple
    ) -> Triple:
        """Interface `expected_motion`; it reacts at once."""
        if _in_reach(parameters, state[TRIGGER], state[PATH], place, before, (car[0], car[1])):
            return float(-state[DECELERATION]), 0.0, 0.0
        return float(min(state[LIMIT], state[GAIN] * (state[CRUISE] - car[1]))), 0.0, 0.0

    @template(inline=False)
    def advance_car(
        parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray, rng: np.random.Generator
    ) -> None:
        """Interface `advance_car`."""
        p = parameters
        car_s, speed = state[CAR_S], state[CAR_SPEED]
        decided = 1.0 if _brakes(p, state, rng) else 0.0
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

    redraw_policy = _fitted_redraw_policy


# State vector, beyond the crossing's own: velocity of the road user in the last tick, (right, along) of the road, m/s,
# the last two changes of the car's speed, m/s, the tree that expects; `OFFSET` and `TURNED` before them.
# TRIGGER of the crossing, by which a default policy tells whether the car brakes, says what it did last: there is no
# distance at which it begins to.
SIDEWAYS, RECEDING, CHANGE, CHANGE_BEFORE, TREE = range(TURNED + 1, TURNED + 6)
FOREST_STATE_DIM = TURNED + 6
_ALWAYS: Final = 1e9  # m
_NOISE: Final = 0.1  # relative to the speed: a car that slows by more brakes

FOREST_WAITING_REWARD: Final = -0.02
"""As `WAITING_REWARD`: a car that creeps is worth waiting for, and this model says when it does not come."""


@kernel
def _draw_tree(parameters: Any, rng: np.random.Generator) -> int:
    count = parameters.forest_roots.shape[0]
    return int(min(count - 1, int(count * rng.random())))


@kernel
def _forest_redraw_policy(parameters: Any, redrawn: FloatArray, rng: np.random.Generator) -> None:
    """Interface `redraw_policy`: another tree expects; what the car did last is not known."""
    redrawn[TRIGGER] = 0.0
    redrawn[TREE] = float(_draw_tree(parameters, rng))
    redrawn[CHANGE] = 0.0
    redrawn[CHANGE_BEFORE] = 0.0


@template(inline=False)
def _leaf(parameters: Any, tree: int, place: Pair, before: Pair, now: Pair, car: Triple, changes: Triple) -> int:
    """Return the leaf of a tree to which a tick belongs.

    Arguments as of `expected_acceleration`, but the velocity before by its parts to the right of the road and along it.
    """
    p = parameters
    x, y = place
    across, along = on_road(p, x, y)
    going = velocity_on_road(p, x, y, now[0], now[1])
    features = features_of(along - car[0] - p.front, across - car[2], before, going, car[1], changes, car[2])
    return leaf_of(p.forest_nodes, p.forest_roots[tree], features)


class _Forest(CarKernels):
    """A car that does what it did in similar recorded ticks."""

    name, own_dim = "forest", FOREST_STATE_DIM - STATE_DIM

    @kernel
    def start_car(parameters: Any, state: FloatArray, rng: np.random.Generator) -> None:
        """Interface `start_car`: where the basic car starts."""
        _basic_start_car(parameters, state, rng)
        state[SIDEWAYS] = 0.0
        state[RECEDING] = 0.0
        state[OFFSET] = 0.0
        state[TURNED] = 0.0
        _forest_redraw_policy(parameters, state, rng)

    @template
    def advance_car(
        parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray, rng: np.random.Generator
    ) -> None:
        """Interface `advance_car`: as in a recorded tick that was like this one."""
        p = parameters
        x, y, car_s, speed = state[ADVERSARY_X], state[ADVERSARY_Y], state[CAR_S], state[CAR_SPEED]
        before, changes = (state[SIDEWAYS], state[RECEDING]), (state[CHANGE], state[CHANGE_BEFORE], state[TURNED])
        leaf = _leaf(p, _draw_tree(p, rng), (x, y), before, (vx, vy), (car_s, speed, state[OFFSET]), changes)
        count = int(p.forest_nodes[leaf, 2])
        donor = int(p.forest_nodes[leaf, 1]) + min(count - 1, int(count * rng.random()))
        speed_after = max(0.0, speed + float(p.forest_donors[donor, 0]))
        distance = 0.0
        if speed > 0.0 or speed_after > 0.0:
            distance = max(0.0, travelled(speed, speed_after, p.time_step) + float(p.forest_donors[donor, 1]))
        next_state[CAR_S] = car_s + distance
        next_state[CAR_SPEED] = speed_after
        next_state[TRIGGER] = _ALWAYS if speed - speed_after > _NOISE * speed else 0.0
        next_state[TREE] = state[TREE]
        next_state[CHANGE] = speed_after - speed
        next_state[CHANGE_BEFORE] = state[CHANGE]
        next_state[OFFSET] = state[OFFSET] + float(p.forest_donors[donor, 2])
        next_state[TURNED] = float(p.forest_donors[donor, 3])
        sideways, receding = velocity_on_road(p, x, y, vx, vy)
        next_state[SIDEWAYS] = sideways
        next_state[RECEDING] = receding

    @template(inline=False)
    def expected_motion(
        parameters: Any, state: FloatArray, place: Pair, before: Pair, now: Pair, car: Triple, changes: Triple
    ) -> Triple:
        """Interface `expected_motion`."""
        p = parameters
        on_road_before = velocity_on_road(p, place[0], place[1], before[0], before[1])
        leaf = _leaf(p, int(state[TREE]), place, on_road_before, now, car, changes)
        change, drift, turned = p.forest_nodes[leaf, 3], p.forest_nodes[leaf, 4], p.forest_nodes[leaf, 5]
        return float(change) / float(p.time_step), float(drift), float(turned)

    @kernel
    def last_changes(parameters: Any, state: FloatArray) -> Triple:
        """Interface `last_changes`."""
        return state[CHANGE], state[CHANGE_BEFORE], state[TURNED]

    @kernel(inline=True)
    def aside(parameters: Any, state: FloatArray) -> Pair:
        """Interface `aside`."""
        return state[OFFSET], state[TURNED]

    @kernel
    def resume_car(parameters: Any, state: FloatArray, redrawn: FloatArray, rng: np.random.Generator) -> None:
        """Interface `resume_car`."""
        redrawn[CAR_SPEED] = state[CAR_SPEED] if rng.random() < 0.8 else parameters.car_start_speed * rng.random()

    redraw_policy = _forest_redraw_policy


@dataclass(frozen=True)
class LearnedCar:
    """A car as its logs show it: by the forest that was learned, if there is one, else by the fitted law.

    Attributes:
        car: what the logs showed.
        known: what is known of the car without its logs; it gives the sensor.
    """

    car: FittedCar
    known: CarModel

    @property
    def kernels(self) -> type[CarKernels]:
        """Kernels of how the predicted car moves."""
        return _Fitted if self.car.forest is None else _Forest

    @property
    def sensor(self) -> type[SensorModel]:
        """Sensor by which the adversary sees the car."""
        return POSE if self.car.forest is not None and self.car.forest.evades else self.known.sensor

    def parameters(self, scenario: Scenario) -> Mapping[str, Any]:
        """Return the forest, or the law of the car as numbers and its priors, and the waiting reward."""
        car = self.car
        usual = WAITING_REWARD if car.forest is None else FOREST_WAITING_REWARD
        waiting_reward = usual if car.waiting_reward is None else car.waiting_reward
        known = {**self.known.parameters(scenario), "waiting_reward": waiting_reward}
        if car.forest is None:
            return known | _law_parameters(car)
        roots, nodes, donors = car.forest.trees
        return known | {
            "forest_roots": roots,
            "forest_nodes": nodes,
            "forest_donors": donors,
            "evades": car.forest.evades,
        }


def _law_parameters(car: FittedCar) -> dict[str, Any]:
    """Return the law of a car as numbers, and its priors: one row each, kind and two numbers (SI)."""
    priors = np.zeros((len(_PRIORS), 3))
    priors[_LIMIT, 1] = _NO_LIMIT
    for row, name in enumerate(_PRIORS):
        if name in car.parameters:
            prior = car.parameters[name].prior
            priors[row] = _KINDS[prior.distribution], prior.first, prior.second
    spread = car.parameters["trigger_spread"]
    kind = {"sharp": 0.0, "episode": 1.0, "tick": 2.0}[car.spread]
    return {
        "by_time": float(car.measure == "time"),
        "gate": {"none": 0.0, "position": 1.0, "predicted": 2.0}[car.gate],
        "spread_kind": kind,
        "spread": float(spread.estimate if spread.estimate is not None else spread.prior.first) if kind else 0.0,
        "priors": priors,
    }
