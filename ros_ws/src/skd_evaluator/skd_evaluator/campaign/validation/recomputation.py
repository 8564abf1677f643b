"""What SKD's own world makes of an episode's recorded motion, to the last bit.

The world draws its noise from the episode's seed, so from a state, the next speed and the adversary's step everything
else of a tick follows: the car's way, the touch, its time and its speed. Of the basic controller even the next speed
does, up to whether it braked. If a recording says otherwise, it did not come from this world.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from skd_adversary.model.objectives import objective_named
from skd_adversary.model.road_users import road_user_named
from skd_adversary.model.safe_path import path_velocities
from skd_sim.arrays import BoolArray, FloatArray
from skd_sim.choices.actions import Actions
from skd_sim.choices.car_dynamics import DYNAMICS
from skd_sim.choices.knowledge import Knowledge
from skd_sim.controllers import basic_acceleration
from skd_sim.dynamics.basic import along_road
from skd_sim.encounter.road import (
    HEADING_NORTH,
    beside_road,
    is_straight_north,
    right_and_along,
    road_pose,
    road_position,
)
from skd_sim.encounter.road_user import Body
from skd_sim.encounter.scenario import Scenario
from skd_sim.episode.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.episode.randomness import Role, generator
from skd_sim.geometry.contact import sweep
from skd_sim.kernels.compilation import kernel
from skd_sim.simulation.world import make_world

ROUNDING = 1e-9
"""m, m/s, s: what another processor's rounding may change."""
CONTACT_ROUNDING = 1e-11
"""m/s, s: what rounding on one machine may change of an impact that states do not tell to the last bit; of SKD's own
encounters at most 3e-12."""
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

    What a cyclist can do next follows from how it turned, which states at ticks do not tell to the last bit; likewise a
    road's coordinate, and a box's heading. Differences of such quantities are rounding on any machine.

    Attributes:
        deviation: the greatest difference, m, m/s or s.
        where: what it is of.
        rounded: the greatest difference of what states tell to the last bit, m, m/s or s; 0: none, not in one bit.
        rounded_where: what that is of.
        late: ticks in which a command was that of an earlier tick, as in real time.
    """

    deviation: float = 0.0
    where: str = ""
    rounded: float = 0.0
    rounded_where: str = ""
    late: int = 0

    def note(
        self, differences: FloatArray | float, what: str, first_tick: int | None = None, *, exact: bool = True
    ) -> None:
        """Take differences of some quantity, one a tick from `first_tick` on, or a single one.

        Args:
            differences: m, m/s or s.
            what: the quantity.
            first_tick: tick of the first of them; None: a single one.
            exact: whether states tell the quantity to the last bit.
        """
        worst, where = _worst(differences, what, first_tick)
        if not worst <= self.deviation:
            self.deviation, self.where = worst, where
        if exact:
            self.note_rounding(differences, what, first_tick)

    def note_rounding(self, differences: FloatArray | float, what: str, first_tick: int | None = None) -> None:
        """Take differences that tell no more than whether this machine rounds as the one of the recording."""
        worst, where = _worst(differences, what, first_tick)
        if not worst <= self.rounded:
            self.rounded, self.rounded_where = worst, where


def _worst(differences: FloatArray | float, what: str, first_tick: int | None) -> tuple[float, str]:
    """Return the greatest of some differences, and what it is of."""
    values = np.atleast_1d(np.abs(differences))
    if not values.size:
        return 0.0, what
    worst = int(np.argmax(values))
    return float(values[worst]), what if first_tick is None else f"{what} at tick {first_tick + worst}"


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
    _adversary(log, found)
    if determined(log.episode.scenario):
        _basic_car(log, found)
        _impact(log, found)
    return found


def determined(scenario: Scenario) -> bool:
    """Whether states at ticks determine how the car drove: not with other dynamics, nor if it decides between ticks."""
    return DYNAMICS[scenario.car.dynamics].known and scenario.control_periods == 1


def _adversary(log: EpisodeLog, found: Recomputed) -> None:
    """Compare each step of the adversary with those that it can choose."""
    episode, walked = log.episode, log.adversary
    ticks, step = len(walked) - 1, episode.scenario.time_step
    if ticks == 0:
        return
    differences = np.full(ticks, math.inf)
    user = road_user_named(episode.scenario.adversary.kind)
    if episode.mode != Mode.REPLAY:
        phi = episode.safe_trajectory
        path = walked[:1] if phi is None else phi.positions
        choices = user.choices(episode.scenario, path, walked)
        differences = _nearest(walked, np.ones(ticks, dtype=bool), step, choices)
        if episode.mode == Mode.KAMIKAZE and episode.actions == Actions.DRAWN and user.within is not None:
            velocities = user.within(episode.scenario, path, walked)
            differences = np.minimum(differences, _largest(walked[:-1] + step * velocities - walked[1:]))
    if follows_phi(episode):
        velocities = _along_phi(log, ticks)
        differences = np.minimum(differences, _largest(walked[:-1] + step * velocities - walked[1:]))
        late = differences > ROUNDING
        if late.any():  # held from an earlier tick, as in real time
            choices = np.vstack([velocities, np.zeros(2)])
            differences[late] = np.minimum(differences[late], _nearest(walked, late, step, choices))
            found.late += int((differences[late] <= ROUNDING).sum())
    by_choice = user.kernels.own_dim == 0 and episode.actions != Actions.DRAWN
    found.note(differences, "the adversary's position", 1, exact=episode.mode == Mode.REPLAY or by_choice)


def follows_phi(episode: Episode) -> bool:
    """Whether the adversary can go as φ does in the same tick: a replay, and a kamikaze that can choose to.

    That is one of objective `deformation`, and any that plans with copies of the car.
    """
    if episode.mode != Mode.KAMIKAZE:
        return episode.mode == Mode.REPLAY
    return objective_named(episode.objective).follows_phi or episode.knows == Knowledge.ITSELF


def _along_phi(log: EpisodeLog, ticks: int) -> FloatArray:
    """Return the velocity in each tick of who goes as φ, ticks × 2, m/s: in a replay φ's own, else as far as it can."""
    episode = log.episode
    assert episode.safe_trajectory is not None
    path = episode.safe_trajectory.positions
    if episode.mode == Mode.REPLAY:
        return path_velocities(path, ticks, episode.safe_trajectory.time_step)
    return road_user_named(episode.scenario.adversary.kind).as_phi(episode.scenario, path, log.adversary)


def _nearest(walked: FloatArray, ticks: BoolArray, step: float, choices: FloatArray) -> FloatArray:
    """Return how far the adversary is, after each of some ticks, from where the best of some velocities takes it."""
    reached = walked[:-1][ticks][:, None] + step * choices
    return np.asarray(_largest(reached - walked[1:][ticks][:, None]).min(axis=1))


def _largest(differences: FloatArray) -> FloatArray:
    return np.asarray(np.abs(differences).max(axis=-1))


def _basic_car(log: EpisodeLog, found: Recomputed) -> None:
    """Compare the car's way with its speeds, and its speeds with what a command and the episode's noise give."""
    episode, states = log.episode, log.car
    scenario = episode.scenario
    car, step = scenario.car, scenario.time_step
    ticks = len(states) - 1
    speed, after = states[:-1, 2], states[1:, 2]
    distance = 0.5 * step * (speed + after)
    line = scenario.road.line
    if scenario.road.straight:
        x, y = states[:-1, 0] + distance * _COS, states[:-1, 1] + distance * _SIN
    else:
        along = right_and_along(line, states[:-1, :2])[:, 1] + distance
        x, y = beside_road(line, np.column_stack([np.zeros(ticks), along])).T
    found.note(x - states[1:, 0], "the car's x", 1, exact=scenario.road.straight)
    found.note(y - states[1:, 1], "the car's y", 1, exact=scenario.road.straight)
    if not scenario.road.straight:
        found.note_rounding(_off_its_way(line, states, distance), "the car's place", 1)
    found.note(np.minimum(0.0, states[:, 2]), "the car's speed", 0)
    if not episode.car.is_known:
        return
    draws = 2.0 * generator(episode.seed, episode.episode_id, Role.CAR).random((ticks, 2)) - 1.0
    rolling = speed + car.speed_noise * draws[:, 0] * speed
    braking = -car.deceleration + car.acceleration_noise * draws[:, 1] * -car.deceleration
    free, braked = np.maximum(0.0, rolling), np.maximum(0.0, rolling + step * braking)
    # As `BasicController.command` has it.
    if scenario.road.straight:
        walked, drove = (_COS * places[:-1, 0] + _SIN * places[:-1, 1] for places in (log.adversary, states))
        ahead = _COS * (log.adversary[:-1, 0] - states[:-1, 0]) + _SIN * (log.adversary[:-1, 1] - states[:-1, 1])
    else:
        walked, drove = (right_and_along(line, places[:-1, :2])[:, 1] for places in (log.adversary, states))
        ahead = walked - drove
    trigger = episode.multiplier * car.safe_distance
    gaps = (ahead - car.front).tolist()
    brakes = np.array([basic_acceleration(gap, trigger, car.deceleration) != 0.0 for gap in gaps], dtype=np.bool_)
    in_time = np.abs(np.where(brakes, braked, free) - after)
    other = np.abs(np.where(brakes, free, braked) - after)
    late = (other <= ROUNDING) & (in_time > ROUNDING)
    if late.any():  # a command to brake can be late only where one was due before, by places of any ticks until then
        apart = walked[:, None] - drove - car.front
        due = (apart >= -ROUNDING) & (apart <= trigger + ROUNDING)
        late &= brakes | [due[: tick + 1, : tick + 1].any() for tick in range(ticks)]
    found.late += int(late.sum())
    found.note(np.where(late, other, in_time), "the car's speed", 1)


def _off_its_way(line: FloatArray, states: FloatArray, distance: FloatArray) -> FloatArray:
    """Return how far a car on a turning road is, after each tick, from where its path coordinate takes it, m.

    The world adds up distances from the start on, so places follow to the last bit; differences add up, too.
    """
    along = np.cumsum(np.concatenate([[road_position(line, *states[0, :2])[0]], distance]))
    places = np.array([road_pose(line, s)[:2] for s in along[1:].tolist()]).reshape(-1, 2)
    return _largest(places - states[1:, :2])


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
    scenario = log.episode.scenario
    exact = scenario.road.straight and not scenario.adversary.is_box and not scenario.others
    for difference, what in (
        (log.impact_time - (touch.tick + touch.fraction) * scenario.time_step, "the impact's time"),
        (log.impact_speed - touch.speed, "the impact's speed"),
    ):
        found.note(difference, what, exact=exact or abs(difference) > CONTACT_ROUNDING)
