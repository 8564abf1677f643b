"""A car that was learned from logs without a law, as the adversary predicts it: by a forest (`car_forest`).

In each tick a tree is drawn, then a donor in the leaf to which the tick's features lead: the car does what it did then.
What the default policy foresees is one tree's opinion, the same tree as long as a state lives: its leaf's median.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import travelled

from skd_adversary.car_models.car_forest import CarForest, features_of, leaf_of
from skd_adversary.crossing.car import basic
from skd_adversary.crossing.crossing import ADVERSARY_X, ADVERSARY_Y, CAR_S, CAR_SPEED, STATE_DIM, TRIGGER
from skd_adversary.crossing.interfaces import on_road, velocity_on_road
from skd_adversary.crossing.parts import CarKernels, Sensor, template

# State vector, beyond the crossing's own: velocity of the road user in the last tick, (right, along) of the road, m/s,
# the last two changes of the car's speed, m/s, and the tree that foresees. The crossing's TRIGGER, by which a default
# policy tells whether the car brakes, says what it did last: there is no distance at which it begins to.
SIDEWAYS, RECEDING, CHANGE, CHANGE_BEFORE, TREE = range(STATE_DIM, STATE_DIM + 5)
FOREST_STATE_DIM = STATE_DIM + 5
_ALWAYS: Final = 1e9  # m
_NOISE: Final = 0.1  # relative to the speed: a car that slows by more brakes

WAITING_REWARD: Final = -0.02
"""As `basic.WAITING_REWARD`: a car that creeps is worth waiting for, and this model says when it does not come."""


@kernel
def _draw_tree(parameters: Any, rng: np.random.Generator) -> int:
    count = parameters.forest_roots.shape[0]
    return int(min(count - 1, int(count * rng.random())))


@kernel
def redraw_policy(parameters: Any, redrawn: FloatArray, rng: np.random.Generator) -> None:
    """Interface `redraw_policy`: another tree foresees; what the car did last is not known."""
    redrawn[TRIGGER] = 0.0
    redrawn[TREE] = float(_draw_tree(parameters, rng))
    redrawn[CHANGE] = 0.0
    redrawn[CHANGE_BEFORE] = 0.0


@kernel
def start_car(parameters: Any, state: FloatArray, rng: np.random.Generator) -> None:
    """Interface `start_car`: where the basic car starts."""
    basic.start_car(parameters, state, rng)
    state[SIDEWAYS] = 0.0
    state[RECEDING] = 0.0
    redraw_policy(parameters, state, rng)


@template("on_road", "velocity_on_road", inline=False)
def _leaf(
    parameters: Any,
    tree: int,
    x: float,
    y: float,
    sideways_before: float,
    receding_before: float,
    vx: float,
    vy: float,
    car_s: float,
    speed: float,
    change: float,
    change_before: float,
) -> int:
    """Return the leaf of a tree to which a tick belongs; its arguments are those of `features_of`."""
    p = parameters
    across, along = on_road(p, x, y)
    sideways, receding = velocity_on_road(p, x, y, vx, vy)
    features = features_of(
        along - car_s - p.front,
        across,
        sideways_before,
        receding_before,
        sideways,
        receding,
        speed,
        change,
        change_before,
    )
    return leaf_of(p.forest_nodes, p.forest_roots[tree], features)


@template("_leaf", "velocity_on_road")
def advance_car(
    parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray, rng: np.random.Generator
) -> None:
    """Interface `advance_car`: as in a recorded tick that was like this one."""
    p = parameters
    x, y, car_s, speed = state[ADVERSARY_X], state[ADVERSARY_Y], state[CAR_S], state[CAR_SPEED]
    leaf = _leaf(
        p,
        _draw_tree(p, rng),
        x,
        y,
        state[SIDEWAYS],
        state[RECEDING],
        vx,
        vy,
        car_s,
        speed,
        state[CHANGE],
        state[CHANGE_BEFORE],
    )
    count = int(p.forest_nodes[leaf, 2])
    donor = int(p.forest_nodes[leaf, 1]) + min(count - 1, int(count * rng.random()))
    speed_after = max(0.0, speed + float(p.forest_donors[donor, 0]))
    way = 0.0
    if speed > 0.0 or speed_after > 0.0:
        way = max(0.0, travelled(speed, speed_after, p.time_step) + float(p.forest_donors[donor, 1]))
    next_state[CAR_S] = car_s + way
    next_state[CAR_SPEED] = speed_after
    next_state[TRIGGER] = _ALWAYS if speed - speed_after > _NOISE * speed else 0.0
    next_state[TREE] = state[TREE]
    next_state[CHANGE] = speed_after - speed
    next_state[CHANGE_BEFORE] = state[CHANGE]
    sideways, receding = velocity_on_road(p, x, y, vx, vy)
    next_state[SIDEWAYS] = sideways
    next_state[RECEDING] = receding


@template("_leaf", "velocity_on_road", inline=False)
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
    """Interface `foreseen_acceleration`."""
    p = parameters
    sideways_before, receding_before = velocity_on_road(p, x, y, vx_before, vy_before)
    leaf = _leaf(
        p, int(state[TREE]), x, y, sideways_before, receding_before, vx, vy, car_s, speed, change, change_before
    )
    return float(p.forest_nodes[leaf, 3]) / float(p.time_step)


@kernel
def last_changes(parameters: Any, state: FloatArray) -> tuple[float, float]:
    """Interface `last_changes`."""
    return state[CHANGE], state[CHANGE_BEFORE]


@kernel
def resume_car(parameters: Any, state: FloatArray, redrawn: FloatArray, rng: np.random.Generator) -> None:
    """Interface `resume_car`."""
    redrawn[CAR_SPEED] = state[CAR_SPEED] if rng.random() < 0.8 else parameters.car_start_speed * rng.random()


KERNELS = CarKernels(
    "forest",
    FOREST_STATE_DIM - STATE_DIM,
    start_car,
    advance_car,
    foreseen_acceleration,
    resume_car,
    redraw_policy,
    last_changes,
)


@dataclass(frozen=True)
class ForestCar:
    """A car that does in each situation what it was seen doing in similar ones.

    Attributes:
        forest: forest that was learned from what the car was seen doing.
        known: what is known of the car without the forest; it gives the sensor.
        waiting_reward: reward of a tick of waiting after φ's end, as `basic.WAITING_REWARD`.
    """

    forest: CarForest
    known: basic.CarModel
    waiting_reward: float = WAITING_REWARD

    @property
    def kernels(self) -> CarKernels:
        """Kernels of how the predicted car moves."""
        return KERNELS

    @property
    def sensor(self) -> Sensor:
        """Sensor by which the adversary sees the car."""
        return self.known.sensor

    def parameters(self, scenario: Scenario) -> Mapping[str, Any]:
        """Return the forest."""
        trees = self.forest.trees
        return {
            **self.known.parameters(scenario),
            "waiting_reward": self.waiting_reward,
            "forest_roots": trees.roots,
            "forest_nodes": trees.nodes,
            "forest_donors": trees.donors,
        }
