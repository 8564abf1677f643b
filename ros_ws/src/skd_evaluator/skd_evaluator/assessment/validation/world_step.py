"""What SKD's own world makes of an episode's recorded motion.

The world draws its noise from the episode's seed, so from a state, the next speed and the adversary's step everything
else of a tick follows: the car's path, the touch, its time and its speed. Of the basic controller the next speed does,
too. A recording that says otherwise is not of this world, of another episode, or damaged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from skd_adversary.crossing.objectives import objective_named
from skd_adversary.crossing.road_users import road_user_named
from skd_adversary.crossing.safe_path import path_velocities
from skd_sim.arrays import FloatArray
from skd_sim.controllers import basic_acceleration
from skd_sim.kernels.compilation import kernel
from skd_sim.options.car_dynamics import DYNAMICS
from skd_sim.scenario.road import (
    HEADING_NORTH,
    beside_road,
    is_straight_north,
    right_and_along,
    road_position,
)
from skd_sim.scenario.road_user import Body
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import sweep
from skd_sim.world.dynamics.basic import along_road
from skd_sim.world.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.world.randomness import Role, generator
from skd_sim.world.world import make_world

ROUNDING = 1e-9
"""m, m/s, s: what another processor's rounding may change."""
UNLIKE = 1.0
"""Deviation where something happened in one of the two and not in the other."""
_COS, _SIN = math.cos(HEADING_NORTH), math.sin(HEADING_NORTH)


class Touch(NamedTuple):
    """First touch of an episode: its tick, the share of the tick, and the car's speed, m/s."""

    tick: int
    fraction: float
    speed: float


@dataclass
class Recomputed:
    """How far a recording is from what the world would have given.

    Attributes:
        deviation: the greatest difference, m, m/s or s.
        where: the quantity that it is of, and the tick.
    """

    deviation: float = 0.0
    where: str = ""

    def note(self, differences: FloatArray | float, what: str, first_tick: int | None = None) -> None:
        """Take differences (m, m/s or s) of some quantity, one a tick from `first_tick` on, or a single one."""
        values = np.atleast_1d(np.abs(differences))
        if values.size and not values.max() <= self.deviation:
            worst = int(np.argmax(values))
            self.deviation = float(values[worst])
            self.where = what if first_tick is None else f"{what} at tick {first_tick + worst}"


@kernel
def _touches(
    adversary: FloatArray,
    car: FloatArray,
    line: FloatArray,
    footprint: tuple[float, float, float],
    shape: tuple[float, float, float],
    first_heading: float,
    time_step: float,
    minimum_speed: float,
) -> tuple[int, float, float]:
    """Return tick, fraction and speed of the first touch that counts, of a car that drives uniformly; −1: none."""
    straight = is_straight_north(line)
    heading = first_heading
    for tick in range(adversary.shape[0] - 1):
        path = driven(line, straight, car[tick], car[tick + 1])
        place, end = (adversary[tick, 0], adversary[tick, 1]), (adversary[tick + 1, 0], adversary[tick + 1, 1])
        velocity = ((end[0] - place[0]) / time_step, (end[1] - place[1]) / time_step)
        if shape[0] == 0.0 and (velocity[0] != 0.0 or velocity[1] != 0.0):
            heading = math.atan2(velocity[1], velocity[0])
        contact, speed = sweep(path, place, end, velocity, heading, footprint, shape, time_step, 0, 1)
        if contact <= 1.0 and speed >= minimum_speed:
            return tick, contact, speed
    return -1, math.inf, 0.0


@kernel
def driven(line: FloatArray, straight: bool, before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the car's way between two recorded states (x, y in m, speed in m/s), as `CarDynamics.advance` gives it."""
    if not straight:
        here, there = road_position(line, before[0], before[1])[0], road_position(line, after[0], after[1])[0]
        return along_road(line, here, max(0.0, there - here), before[2], after[2])
    path = np.empty((2, 4))
    path[0, 0], path[0, 1], path[0, 2], path[0, 3] = before[0], before[1], HEADING_NORTH, before[2]
    path[1, 0], path[1, 1], path[1, 2], path[1, 3] = after[0], after[1], HEADING_NORTH, after[2]
    return path


def first_touch(log: EpisodeLog, *, margin: float = 0.0) -> Touch | None:
    """Return the first touch in a log that counts as a collision, with the adversary or one of the others.

    States are joined by straight lines.

    Args:
        log: what happened; its states must be finite.
        margin: by how much the car's footprint is made smaller on each side, m.
    """
    found = [touch for touch in touches(log, margin=margin) if touch is not None]
    return min(found, default=None)


def touches(log: EpisodeLog, *, margin: float = 0.0) -> list[Touch | None]:
    """Return the first touch with the adversary, then with each of the others, each as if it were the only one."""
    scenario = log.episode.scenario
    car, seen = (
        scenario.car,
        [scenario.others_at(tick) for tick in range(len(log.adversary))] if scenario.others else [],
    )
    bodies: list[tuple[Body, FloatArray]] = [(scenario.adversary, log.adversary)]
    bodies += [(other, np.array([at[i][:2] for at in seen])) for i, other in enumerate(scenario.others)]
    found: list[Touch | None] = []
    for body, way in bodies:
        tick, fraction, speed = _touches(
            way,
            log.car,
            scenario.road.line,
            (car.front - margin, car.rear - margin, car.half_width - margin),
            body.shape,
            body.first_heading,
            scenario.time_step,
            scenario.collision.minimum_impact_speed,
        )
        found.append(Touch(tick, fraction, speed) if tick >= 0 else None)
    return found


def recompute(log: EpisodeLog) -> Recomputed:
    """Compare a log with what the world gives, tick by tick from the recorded states.

    Where the car's motion depends on more than is recorded, only the start and the adversary are compared.

    Args:
        log: what is said to have happened, with any outcome; its states must be finite.
    """
    found = Recomputed()
    world = make_world(log.episode)
    found.note(log.adversary[0] - np.array(world.adversary[:2]), "the adversary's start")
    found.note(log.car[0] - np.array([world.car.x, world.car.y, world.car.speed]), "the car's start")
    if len(log.car) > 1:
        _adversary(log, found)
        if determined(log.episode.scenario):
            _car(log, found)
            _impact(log, found)
    return found


def determined(scenario: Scenario) -> bool:
    """Whether states at ticks determine how the car drove: not with other dynamics, nor if it decides between ticks."""
    return DYNAMICS[scenario.car.dynamics].known and scenario.control_periods == 1


def follows_phi(episode: Episode) -> bool:
    """Whether the adversary can go as φ does: a replay, and a kamikaze that can choose to."""
    if episode.mode != Mode.KAMIKAZE:
        return episode.mode == Mode.REPLAY
    return objective_named(episode.objective).follows_phi


def _adversary(log: EpisodeLog, found: Recomputed) -> None:
    """Compare each step of the adversary with those that it can choose.

    In real time a command is held until the next one comes, so whoever follows φ may go as φ did in another tick.
    """
    episode, walked = log.episode, log.adversary
    scenario, ticks = episode.scenario, len(walked) - 1
    user = road_user_named(scenario.adversary.kind)
    path = walked[:1] if episode.safe_trajectory is None else episode.safe_trajectory.positions
    choices: list[FloatArray] = []
    if episode.mode != Mode.REPLAY:
        choices.append(user.choices(scenario, path, walked))
    if follows_phi(episode):
        replayed = episode.mode == Mode.REPLAY
        as_phi = path_velocities(path, ticks, scenario.time_step) if replayed else user.as_phi(scenario, path, walked)
        choices.append(np.broadcast_to(np.vstack([as_phi, np.zeros(2)]), (ticks, ticks + 1, 2)))
    reached = walked[:-1, None] + scenario.time_step * np.concatenate(choices, axis=1)
    found.note(np.abs(reached - walked[1:, None]).max(axis=-1).min(axis=1), "the adversary's position", 1)


def _car(log: EpisodeLog, found: Recomputed) -> None:
    """Compare the car's path with its speeds, and a basic car's speeds with what braking and the noise give."""
    episode, states = log.episode, log.car
    scenario = episode.scenario
    car, step, line = scenario.car, scenario.time_step, scenario.road.line
    ticks = len(states) - 1
    speed, after = states[:-1, 2], states[1:, 2]
    distance = 0.5 * step * (speed + after)
    if scenario.road.straight:
        x, y = states[:-1, 0] + distance * _COS, states[:-1, 1] + distance * _SIN
    else:
        along = right_and_along(line, states[:-1, :2])[:, 1] + distance
        x, y = beside_road(line, np.column_stack([np.zeros(ticks), along])).T
    found.note(x - states[1:, 0], "the car's x", 1)
    found.note(y - states[1:, 1], "the car's y", 1)
    found.note(np.minimum(0.0, states[:, 2]), "the car's speed", 0)
    if not episode.car.is_known or episode.mode == Mode.SAFE:  # φ is made before any car is looked at
        return
    draws = 2.0 * generator(episode.seed, episode.episode_id, Role.CAR).random((ticks, 2)) - 1.0
    rolling = speed + car.speed_noise * draws[:, 0] * speed
    braking = -car.deceleration + car.acceleration_noise * draws[:, 1] * -car.deceleration
    free = np.abs(np.maximum(0.0, rolling) - after)
    braked = np.abs(np.maximum(0.0, rolling + step * braking) - after)
    if log.timing.delay > 0.0:  # in real time a command may be that of an earlier tick
        found.note(np.minimum(free, braked), "the car's speed", 1)
        return
    # As `BasicController.command` has it.
    if scenario.road.straight:
        ahead = _COS * (log.adversary[:-1, 0] - states[:-1, 0]) + _SIN * (log.adversary[:-1, 1] - states[:-1, 1])
    else:
        walked, drove = (right_and_along(line, places[:-1, :2])[:, 1] for places in (log.adversary, states))
        ahead = walked - drove
    trigger = episode.multiplier * car.safe_distance
    gaps = (ahead - car.front).tolist()
    brakes = np.array([basic_acceleration(gap, trigger, car.deceleration) != 0.0 for gap in gaps], dtype=np.bool_)
    found.note(np.where(brakes, braked, free), "the car's speed", 1)


def _impact(log: EpisodeLog, found: Recomputed) -> None:
    """Compare the impact with the first touch of the recorded motion."""
    touch = first_touch(log)
    last = len(log.adversary) - 2
    if log.outcome == Outcome.ABORTED and (touch is None or touch.tick == last):
        return
    if log.outcome != Outcome.COLLISION or touch is None or touch.tick != last:
        if touch is not None or log.outcome == Outcome.COLLISION:
            found.note(UNLIKE, "the touch")
        return
    found.note(log.impact_time - (touch.tick + touch.fraction) * log.episode.scenario.time_step, "the impact's time")
    found.note(log.impact_speed - touch.speed, "the impact's speed")
