"""What SKD's own world makes of an episode's recorded motion, to the last bit.

The world draws its noise from the episode's seed, so from a state, the next speed and the pedestrian's step everything
else of a tick follows: the car's way, the touch, its time and its speed. Of the basic controller even the next speed
does, up to whether it braked. What a recording says otherwise did not come from this world.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from skd_adversary.crossing import ACTION_COUNT, action_velocity
from skd_sim.compilation import kernel
from skd_sim.controllers import basic_acceleration
from skd_sim.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.geometry import first_contact, to_car_frame
from skd_sim.objective import Objective
from skd_sim.randomness import Role, generator
from skd_sim.scenario import HEADING_NORTH, Scenario
from skd_sim.trajectory import FloatArray
from skd_sim.world import make_world

ROUNDING = 1e-9
"""m, m/s, s: what another processor's rounding may change."""
UNLIKE = 1.0
"""Deviation where something happened in one of the two and not in the other."""
_COS, _SIN = math.cos(HEADING_NORTH), math.sin(HEADING_NORTH)

BoolArray = npt.NDArray[np.bool_]


class Touch(NamedTuple):
    """First touch of an episode: its tick, the share of the tick, and the car's speed, m/s."""

    tick: int
    fraction: float
    speed: float


@dataclass
class Recomputed:
    """How far a recording is from what the world gives.

    Attributes:
        deviation: the greatest difference, m, m/s or s; 0: equal to the last bit.
        where: what it is of.
        late: ticks in which a command was that of an earlier tick, as in real time.
    """

    deviation: float = 0.0
    where: str = ""
    late: int = 0

    def note(self, differences: FloatArray | float, what: str, first_tick: int | None = None) -> None:
        """Take differences of some quantity, one a tick from `first_tick` on, or a single one."""
        values = np.atleast_1d(np.abs(differences))
        worst = int(np.argmax(values)) if values.size else 0
        if values.size and not values[worst] <= self.deviation:
            self.deviation = float(values[worst])
            self.where = what if first_tick is None else f"{what} at tick {first_tick + worst}"


@kernel
def _touches(
    pedestrian: FloatArray,
    car: FloatArray,
    heading: float,
    front: float,
    rear: float,
    half_width: float,
    radius: float,
    minimum_speed: float,
) -> tuple[int, float, float]:
    """Return tick, fraction and speed of the first touch that counts, of a car that drives uniformly; −1: none."""
    for tick in range(pedestrian.shape[0] - 1):
        ahead, left = to_car_frame(pedestrian[tick, 0], pedestrian[tick, 1], car[tick, 0], car[tick, 1], heading)
        ahead_after, left_after = to_car_frame(
            pedestrian[tick + 1, 0], pedestrian[tick + 1, 1], car[tick + 1, 0], car[tick + 1, 1], heading
        )
        contact = first_contact(ahead, left, ahead_after, left_after, front, rear, half_width, radius)
        if contact <= 1.0:
            speed = car[tick, 2] + contact * (car[tick + 1, 2] - car[tick, 2])
            if speed >= minimum_speed:
                return tick, contact, speed
    return -1, math.inf, 0.0


def first_touch(log: EpisodeLog, *, margin: float = 0.0) -> Touch | None:
    """Return the first touch in a log that counts as a collision; states are joined by straight lines.

    Args:
        log: its states must be finite.
        margin: by which the car's footprint is smaller on each side, m.
    """
    scenario = log.episode.scenario
    car = scenario.car
    tick, fraction, speed = _touches(
        log.pedestrian,
        log.car,
        HEADING_NORTH,
        car.front - margin,
        car.rear - margin,
        car.half_width - margin,
        scenario.pedestrian.radius,
        scenario.collision.minimum_impact_speed,
    )
    return Touch(tick, fraction, speed) if tick >= 0 else None


def recompute(log: EpisodeLog) -> Recomputed:
    """Compare a log with what the world gives, tick by tick from the recorded states.

    Where the car's motion depends on more than is recorded, only the start and the pedestrian are compared.

    Args:
        log: of whatever outcome; its states must be finite.
    """
    found = Recomputed()
    world = make_world(log.episode)
    found.note(log.pedestrian[0] - np.array(world.pedestrian[:2]), "the pedestrian's start")
    found.note(log.car[0] - np.array([world.car.x, world.car.y, world.car.speed]), "the car's start")
    _pedestrian(log, found)
    if determined(log.episode.scenario):
        _basic_car(log, found)
        _impact(log, found)
    return found


def determined(scenario: Scenario) -> bool:
    """Whether states at ticks say how the car drove: not of other dynamics, nor where it decides between ticks."""
    return scenario.car.dynamics == "basic" and scenario.control_periods == 1


def _pedestrian(log: EpisodeLog, found: Recomputed) -> None:
    """Compare each step of the pedestrian with those that the adversary can choose."""
    episode, walked = log.episode, log.pedestrian
    ticks, step = len(walked) - 1, episode.scenario.time_step
    if ticks == 0:
        return
    differences = np.full(ticks, math.inf)
    if episode.mode != Mode.REPLAY:
        speed = episode.scenario.pedestrian.speed
        choices = np.array([action_velocity(action, speed) for action in range(ACTION_COUNT)])
        differences = _nearest(walked, np.ones(ticks, dtype=bool), step, choices)
    if follows_phi(episode):
        velocities = _along_phi(episode, ticks)
        differences = np.minimum(differences, _largest(walked[:-1] + step * velocities - walked[1:]))
        late = differences > ROUNDING
        if late.any():  # held from an earlier tick, as in real time
            choices = np.vstack([velocities, np.zeros(2)])
            differences[late] = np.minimum(differences[late], _nearest(walked, late, step, choices))
            found.late += int((differences[late] <= ROUNDING).sum())
    found.note(differences, "the pedestrian's position", 1)


def follows_phi(episode: Episode) -> bool:
    """Whether the pedestrian can go as φ does in the same tick: a replay, or a kamikaze of objective `deformation`."""
    deforms = episode.mode == Mode.KAMIKAZE and episode.objective == Objective.DEFORMATION
    return episode.mode == Mode.REPLAY or deforms


def _along_phi(episode: Episode, ticks: int) -> FloatArray:
    """Return φ's velocity in each tick, ticks × 2, m/s; none after its end."""
    assert episode.safe_trajectory is not None
    path = episode.safe_trajectory.positions
    velocities = np.zeros((ticks, 2))
    own = min(ticks, len(path) - 1)
    velocities[:own] = (path[1 : own + 1] - path[:own]) / episode.safe_trajectory.time_step
    return velocities


def _nearest(walked: FloatArray, ticks: BoolArray, step: float, choices: FloatArray) -> FloatArray:
    """Return how far the pedestrian is, after each of some ticks, from where the best of some velocities takes him."""
    reached = walked[:-1][ticks][:, None] + step * choices
    return np.asarray(_largest(reached - walked[1:][ticks][:, None]).min(axis=1))


def _largest(differences: FloatArray) -> FloatArray:
    return np.asarray(np.abs(differences).max(axis=-1))


def _basic_car(log: EpisodeLog, found: Recomputed) -> None:
    """Compare the car's way with its speeds, and its speeds with what a command and the episode's noise give."""
    episode, driven = log.episode, log.car
    scenario = episode.scenario
    car, step = scenario.car, scenario.time_step
    ticks = len(driven) - 1
    speed, after = driven[:-1, 2], driven[1:, 2]
    distance = 0.5 * step * (speed + after)
    found.note(driven[:-1, 0] + distance * _COS - driven[1:, 0], "the car's x", 1)
    found.note(driven[:-1, 1] + distance * _SIN - driven[1:, 1], "the car's y", 1)
    found.note(np.minimum(0.0, driven[:, 2]), "the car's speed", 0)
    if episode.controller != "basic":
        return
    draws = 2.0 * generator(episode.seed, episode.episode_id, Role.CAR).random((ticks, 2)) - 1.0
    rolling = speed + car.speed_noise * draws[:, 0] * speed
    braking = -car.deceleration + car.acceleration_noise * draws[:, 1] * -car.deceleration
    free, braked = np.maximum(0.0, rolling), np.maximum(0.0, rolling + step * braking)
    # As `BasicController.command` has it.
    ahead = _COS * (log.pedestrian[:-1, 0] - driven[:-1, 0]) + _SIN * (log.pedestrian[:-1, 1] - driven[:-1, 1])
    trigger = episode.multiplier * car.safe_distance
    gaps = (ahead - car.front).tolist()
    brakes = np.array([basic_acceleration(gap, trigger, car.deceleration) != 0.0 for gap in gaps], dtype=np.bool_)
    in_time = np.abs(np.where(brakes, braked, free) - after)
    other = np.abs(np.where(brakes, free, braked) - after)
    late = (other <= ROUNDING) & (in_time > ROUNDING)
    found.late += int(late.sum())
    found.note(np.where(late, other, in_time), "the car's speed", 1)


def _impact(log: EpisodeLog, found: Recomputed) -> None:
    """Compare the impact with the first touch of the recorded motion."""
    touch = first_touch(log)
    last = len(log.pedestrian) - 2
    if log.outcome == Outcome.ABORTED and (touch is None or touch.tick == last):
        return
    if log.outcome != Outcome.COLLISION or touch is None or touch.tick != last:
        if touch is not None or log.outcome == Outcome.COLLISION:
            found.note(UNLIKE, "the touch")
        return
    found.note(log.impact_time - (touch.tick + touch.fraction) * log.episode.scenario.time_step, "the impact's time")
    found.note(log.impact_speed - touch.speed, "the impact's speed")
