"""A kamikaze of objective deformation that knows the basic car's true state in every tick, and not what it will draw.

Between the clairvoyant one, which knows every draw, and the one of an assessment, which sees the car through its
sensor: so what each of the two kinds of ignorance costs can be told apart. It plans with the same search, over the same
actions; its model of the car is the world's own, the noise of the acceleration included, and it sees place and speed.
"""

from __future__ import annotations

import collections
import dataclasses
import math
import sys
from typing import Any, Final

import numpy as np
from skd_adversary import deformation_kamikaze
from skd_adversary.adversary import car_model_for
from skd_adversary.crossing import (
    AS_PHI,
    CAR_SPEED,
    CAR_Y,
    PEDESTRIAN_X,
    PEDESTRIAN_Y,
    TRIGGER,
    CrossingParameters,
    action_velocity,
    path_velocity,
)
from skd_adversary.deformation_kamikaze import ROW, deformation_kamikaze_pomdp
from skd_adversary.planning.belief import ParticleBelief
from skd_adversary.planning.planner import Planner, PlannerOptions
from skd_adversary.planning.pomdp import FloatArray, Pomdp
from skd_sim.compilation import kernel, specialise
from skd_sim.controllers import basic_acceleration
from skd_sim.episode import Episode
from skd_sim.geometry import first_contact
from skd_sim.motion import draw_relative, next_speed, travelled
from skd_sim.randomness import Role, generator
from skd_sim.state import CarState

_EXPLORATION: Final = 3.0  # as kamikazes of objective deformation

_namedtuple: Any = collections.namedtuple  # whose fields are known at run time only
InformedParameters = _namedtuple("InformedParameters", (*CrossingParameters._fields, "acceleration_noise"))


@kernel(inline=True)
def move(
    parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray, rng: np.random.Generator
) -> float:
    """As `crossing.move`, with the noise that the world's car has; it draws as the world does, speed first."""
    p = parameters
    x, y = state[PEDESTRIAN_X], state[PEDESTRIAN_Y]
    x_after, y_after = x + p.time_step * vx, y + p.time_step * vy
    car_y, speed = state[CAR_Y], state[CAR_SPEED]
    speed_noise = draw_relative(p.speed_noise, rng)
    braking = basic_acceleration(y - car_y - p.front, state[TRIGGER], p.deceleration)
    acceleration = braking * (1.0 + draw_relative(p.acceleration_noise, rng))
    speed_after = next_speed(speed, acceleration, speed_noise, p.time_step)
    car_y_after = car_y + travelled(speed, speed_after, p.time_step)
    next_state[PEDESTRIAN_X], next_state[PEDESTRIAN_Y] = x_after, y_after
    next_state[CAR_Y], next_state[CAR_SPEED] = car_y_after, speed_after
    next_state[TRIGGER] = state[TRIGGER]
    margin = p.radius + p.half_width
    if (x < -margin and x_after < -margin) or (x > margin and x_after > margin):
        return math.inf
    return first_contact(y - car_y, -x, y_after - car_y_after, -x_after, p.front, p.rear, p.half_width, p.radius)


@kernel(inline=True)
def _observe_state(
    parameters: Any, state: FloatArray, action: int, observation: FloatArray, rng: np.random.Generator
) -> None:
    """See the car's place (m) and speed (m/s) as they are."""
    observation[0], observation[1] = state[CAR_Y], state[CAR_SPEED]


def informed_pomdp(episode: Episode) -> Pomdp:
    """Return the kamikaze's model of an episode in which the car's state is seen as it is.

    Args:
        episode: kamikaze mode, basic controller, basic car.
    """
    assert episode.safe_trajectory is not None
    model = deformation_kamikaze_pomdp(
        episode.scenario,
        car_model_for(episode.controller, episode.multiplier),
        start=episode.start,
        gap=episode.start_gap,
        path=episode.safe_trajectory.positions,
        maximum_distance=episode.maximum_distance,
    )
    template = getattr(deformation_kamikaze.step, "py_func", deformation_kamikaze.step)
    return dataclasses.replace(
        model,
        name="deformation_kamikaze_informed",
        observation_dim=2,
        parameters=InformedParameters(*model.parameters, episode.scenario.car.acceleration_noise),
        step=specialise(template, "informed", {"crossing": sys.modules[__name__]}, inline=True),
        observe=_observe_state,
    )


class InformedAdversary:
    """Plans from the car's true state, which it is told in every tick; see `Adversary`.

    Attributes:
        position: of the pedestrian at the end of the last action, (x, y), m.
    """

    depletions: Final = 0

    def __init__(self, episode: Episode, simulations: int) -> None:
        """Prepare for an episode (kamikaze mode, basic controller, basic car) with so many simulations a decision."""
        model = informed_pomdp(episode)
        rng = generator(episode.seed, episode.episode_id, Role.PLANNER)
        self._parameters = model.parameters
        self._planner = Planner(model, PlannerOptions(simulations=simulations, exploration=_EXPLORATION), rng)
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
            vx, vy = action_velocity(self._action, p.pedestrian_speed)
        self._tick += 1
        self.position = (x + p.time_step * vx, y + p.time_step * vy)
        return vx, vy
