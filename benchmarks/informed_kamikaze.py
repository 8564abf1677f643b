"""A kamikaze of objective deformation that knows the basic car's true state in every tick, and not what it will draw.

Between the clairvoyant one, which knows every draw, and the one of an assessment, which sees the car through its
sensor: so what each of the two kinds of ignorance costs can be told apart. It plans with the same search, over the same
actions; its model of the car is the world's own, the noise of the acceleration included, and it sees place and speed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from skd_adversary.model.car import basic
from skd_adversary.model.car.basic import CarModel, known_basic_car
from skd_adversary.model.composer import compose
from skd_adversary.model.crossing import ADVERSARY_X, ADVERSARY_Y, CAR_S, CAR_SPEED, STATE_DIM, TRIGGER
from skd_adversary.model.interfaces import on_road
from skd_adversary.model.objectives import objective_named
from skd_adversary.model.parts import SEARCH, CarKernels, Sensor, template
from skd_adversary.model.road_user.pedestrian import AS_PHI, action_velocity
from skd_adversary.model.safe_path import path_velocity
from skd_adversary.planning.belief import ParticleBelief
from skd_adversary.planning.planner import Planner
from skd_adversary.planning.pomdp import Pomdp
from skd_sim.arrays import FloatArray
from skd_sim.choices.objective import Objective
from skd_sim.controllers import basic_acceleration
from skd_sim.encounter.scenario import Scenario
from skd_sim.episode.episode import Episode
from skd_sim.episode.randomness import Role, generator
from skd_sim.geometry.motion import draw_relative, next_speed, travelled
from skd_sim.kernels.compilation import kernel
from skd_sim.state import CarState

ROW: Final = STATE_DIM  # neither this car nor an adversary has more of its own in the state
_EXPLORATION: Final = 3.0  # as kamikazes of objective deformation


@template("on_road")
def advance_car(
    parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray, rng: np.random.Generator
) -> None:
    """Interface `advance_car`, with the noise that the world's car has; it draws as the world does, speed first."""
    p = parameters
    car_s, speed = state[CAR_S], state[CAR_SPEED]
    _, along = on_road(p, state[ADVERSARY_X], state[ADVERSARY_Y])
    speed_noise = draw_relative(p.speed_noise, rng)
    braking = basic_acceleration(along - car_s - p.front, state[TRIGGER], p.deceleration)
    acceleration = braking * (1.0 + draw_relative(p.acceleration_noise, rng))
    speed_after = next_speed(speed, acceleration, speed_noise, p.time_step)
    next_state[CAR_S] = car_s + travelled(speed, speed_after, p.time_step)
    next_state[CAR_SPEED] = speed_after
    next_state[TRIGGER] = state[TRIGGER]


@dataclasses.dataclass(frozen=True)
class _WorldsCar:
    """The basic car as the world moves it."""

    model: CarModel

    @property
    def kernels(self) -> CarKernels:
        """How it moves."""
        return _KERNELS

    @property
    def sensor(self) -> Sensor:
        """That of the basic car; what it would see is not used."""
        return self.model.sensor

    def parameters(self, scenario: Scenario) -> Mapping[str, Any]:
        """Return those of the basic car, with the noise of its acceleration (relative)."""
        return {**self.model.parameters(scenario), "acceleration_noise": scenario.car.acceleration_noise}


_KERNELS: Final = dataclasses.replace(basic.KERNELS, name="worlds_basic", advance_car=advance_car)


@kernel(inline=True)
def _observe_state(
    parameters: Any, state: FloatArray, action: int, observation: FloatArray, rng: np.random.Generator
) -> None:
    """See the car's place (m) and speed (m/s) as they are."""
    observation[0], observation[1] = state[CAR_S], state[CAR_SPEED]


def informed_pomdp(episode: Episode) -> Pomdp:
    """Return the kamikaze's model of an episode in which the car's state is seen as it is.

    Args:
        episode: kamikaze mode, basic controller, basic car.
    """
    assert episode.safe_trajectory is not None
    model = compose(
        episode.scenario,
        objective_named(Objective.DEFORMATION),
        _WorldsCar(known_basic_car(episode.multiplier)),
        start=episode.start,
        gap=episode.start_gap,
        path=episode.safe_trajectory.positions,
        maximum_distance=episode.maximum_distance,
    )
    return dataclasses.replace(model, name=f"{model.name}_informed", observation_dim=2, observe=_observe_state)


class InformedAdversary:
    """Plans from the car's true state, which it is told in every tick; see `Adversary`.

    Attributes:
        position: of the adversary at the end of the last action, (x, y), m.
    """

    depletions: Final = 0

    def __init__(self, episode: Episode, simulations: int) -> None:
        """Prepare for an episode (kamikaze mode, basic controller, basic car) with so many simulations a decision."""
        model = informed_pomdp(episode)
        rng = generator(episode.seed, episode.episode_id, Role.PLANNER)
        self._parameters = model.parameters
        options = dataclasses.replace(SEARCH, simulations=simulations, exploration=_EXPLORATION)
        self._planner = Planner(model, options, rng)
        self._belief = ParticleBelief(model, 1, rng)
        self._trigger = episode.multiplier * episode.scenario.car.safe_distance
        self.position = episode.start
        self._worst = 0.0
        self._tick = 0
        self._action: int | None = None

    def act(self, car: CarState) -> tuple[float, float]:
        """Plan from where the car is; see `Adversary.act`."""
        p = self._parameters
        x, y = self.position
        at = p.path[min(self._tick, len(p.path) - 1)]
        self._worst = max(self._worst, (x - at[0]) ** 2 + (y - at[1]) ** 2)
        if self._action is not None:
            self._planner.advance(self._action, np.array([car.y, car.speed]))
        state = self._belief.particles[0]
        state[:ROW] = x, y, car.y, car.speed, self._trigger
        state[ROW:] = self._worst, self._tick, 0.0
        self._action = self._planner.plan(self._belief)
        if self._action == AS_PHI:
            vx, vy = path_velocity(p.path, self._tick, p.time_step)
        else:
            vx, vy = action_velocity(self._action, p.adversary_speed)
        self._tick += 1
        self.position = (x + p.time_step * vx, y + p.time_step * vy)
        return vx, vy
