"""One trial of the margin: candidate trajectories of the road user, and the best hit among those that were driven.

A trial is one nominal trajectory φ and one set of draws. A candidate is a sequence of actions, one for each tick. Where
it leads and how far it deviates from φ is known without the car; what the car does is known once it was driven.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from skd_adversary.crossing.model import RoadUserMotion
from skd_adversary.crossing.path import path_velocities
from skd_adversary.crossing.road_users import AS_PHI, PEDESTRIAN, road_user_named
from skd_sim.arrays import BoolArray, FloatArray, IntArray
from skd_sim.scenario.road import right_and_along, road_position
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome
from skd_sim.world.state import Trajectory

from skd_evaluator.margin.actions import velocities
from skd_evaluator.metrics.deviation import Hit, hit_of

ENOUGH = 1e-9
"""m: a trajectory that deviates less is φ itself."""
NEAR_MISSES = 8
"""Kept for each trial."""
_NEAR = 2.0  # m between car and road user, below which a candidate is a near miss
_SUB_STEPS = np.array([0.25, 0.5, 0.75, 1.0])  # of a tick at which the clearance is looked at


class Candidate(NamedTuple):
    """A sequence of actions, and where it leads.

    Attributes:
        actions: number of the action in each tick.
        positions: of the road user at each tick, (ticks + 1) × 2, m.
        deviations: greatest distance from φ up to each tick, m.
        reaches: whether the road user is where the car may drive, in each tick.
    """

    actions: IntArray
    positions: FloatArray
    deviations: FloatArray
    reaches: BoolArray

    def last_tick(self, bound: float) -> int:
        """Return the last tick in which it can be hit with a deviation below a bound (m); −1: in none."""
        found = np.flatnonzero(self.reaches & (self.deviations[:-1] < bound))
        return int(found[-1]) if found.size else -1


class NearMiss(NamedTuple):
    """A candidate that was driven and nearly hit.

    Attributes:
        deviation: up to the moment of least clearance, m.
        clearance: least distance between the moving car and the road user, m.
        actions: number of the action in each tick.
        tick: of least clearance.
    """

    deviation: float
    clearance: float
    actions: IntArray
    tick: int


class ActionSpace:
    """What the trials of one φ have in common: where sequences of actions lead.

    Attributes:
        ticks: number of ticks of a sequence.
        path: φ, n × 2, m.
        phi: positions of φ at ticks 0 … ticks, held at its end, m.
        as_phi: number of the action "as φ".
        action_count: how many actions there are in a tick.
        table: velocities of the actions in each tick, ticks × actions × 2, m/s; None: they depend on the road user's
            state.
    """

    def __init__(self, scenario: Scenario, path: FloatArray) -> None:
        """Prepare a φ, n × 2, m."""
        self.scenario, self.path = scenario, np.ascontiguousarray(path, dtype=np.float64)
        self.ticks = ticks = scenario.ticks
        self.phi = self.path[np.minimum(np.arange(ticks + 1), len(path) - 1)]
        user = road_user_named(scenario.adversary.kind)
        self.is_pedestrian, self._motion = user is PEDESTRIAN, RoadUserMotion(user, scenario, self.path)
        self._wanted = path_velocities(self.path, ticks, scenario.time_step).tolist()
        first = velocities(scenario, self.path, 0, self.path[:1])
        self.action_count = len(first)
        self.as_phi = AS_PHI if self.is_pedestrian else len(first) - 1
        self.table: FloatArray | None = None
        if self.is_pedestrian:
            self.table = np.array([velocities(scenario, self.path, tick) for tick in range(ticks)])
        self._strip = scenario.car.half_width + scenario.adversary.reach
        self._anywhere = bool(scenario.others)

    def candidate(self, actions: IntArray) -> Candidate:
        """Return where a sequence of actions leads."""
        step = self.scenario.time_step
        if self.table is not None:
            moved = self.table[np.arange(len(actions)), actions]
            positions = np.concatenate([self.path[:1], self.path[0] + np.cumsum(step * moved, axis=0)])
        else:
            positions = self._moved(actions)
        away = positions - self.phi
        deviations = np.maximum.accumulate(np.sqrt(away[:, 0] ** 2 + away[:, 1] ** 2))
        return Candidate(actions, positions, deviations, self._reaches(positions))

    def _moved(self, actions: IntArray) -> FloatArray:
        """Return where a road user with a state of its own goes, positions at ticks, m."""
        step, motion = self.scenario.time_step, self._motion
        motion.begin()
        x, y = self.path[0].tolist()
        found = [(x, y)]
        for action, (vx, vy) in zip(actions.tolist(), self._wanted, strict=True):
            if action == self.as_phi:
                vx, vy = motion.nearest(vx, vy)
            else:
                vx, vy = motion.velocity(action)
            motion.move(vx, vy)
            x, y = x + step * vx, y + step * vy
            found.append((x, y))
        return np.array(found)

    def _reaches(self, positions: FloatArray) -> BoolArray:
        if self._anywhere:
            return np.ones(len(positions) - 1, dtype=bool)
        road = self.scenario.road
        across = positions[:, 0] if road.straight else right_and_along(road.line, positions)[:, 0]
        inside = np.abs(across) <= self._strip
        crosses = across[:-1] * across[1:] < 0.0
        reached: BoolArray = inside[:-1] | inside[1:] | crosses
        lost = self._lost(positions)
        if lost.any():  # the episode is over
            reached[int(np.argmax(lost)) :] = False
        return reached

    def _lost(self, positions: FloatArray) -> BoolArray:
        """Return whether the road user cannot meet the car any more, at each of positions, n × 2, m."""
        low, high, first, last = self.scenario.end.loss
        place = positions if self.scenario.road.straight else right_and_along(self.scenario.road.line, positions)
        across, along = place[:, 0], place[:, 1]
        lost: BoolArray = (low < across) & (across < high) & (first < along) & (along < last)
        return lost

    def actions_along(self, positions: FloatArray) -> IntArray:
        """Return the actions that come nearest to a trajectory, positions at ticks, n × 2, m; as φ after its end."""
        ticks = len(self.phi) - 1
        found = np.full(ticks, self.as_phi, np.int64)
        walked = self.path[:1]
        for tick, target in enumerate(positions[1 : ticks + 1]):
            step = self.scenario.time_step * self._velocities(tick, walked)
            if tick == len(positions) - 2:  # cut at the contact: its direction counts
                own = target - walked[-1]
                along = step @ own / max(float(np.hypot(*own)), ENOUGH)
                found[tick] = int(np.argmax(along - np.abs(np.hypot(*step.T) - along)))
            else:
                found[tick] = int(np.argmin(np.hypot(*(walked[-1] + step - target).T)))
            walked = np.concatenate([walked, walked[-1:] + step[found[tick]]])
        return found

    def _velocities(self, tick: int, walked: FloatArray) -> FloatArray:
        return velocities(self.scenario, self.path, tick, walked) if self.table is None else self.table[tick]


class Trial:
    """One trial, and what is known of it.

    Attributes:
        episode: kamikaze mode; its objective does not matter.
        prescribed: the episode in which the road user follows φ, a trajectory that candidates take the place of.
        least: least deviation of a hit, m; η_max: none was found.
        best: the hit of least deviation.
        hit: the episode that ended in it.
        actions: the actions of `best`; None where it was not found by a sequence of them.
        tick: in which `best` hits.
        near_misses: by deviation.
        driven: how many candidates were driven.
    """

    def __init__(self, episode: EpisodeSpec, space: ActionSpace) -> None:
        assert episode.safe_trajectory is not None
        self.episode, self.space = episode, space
        self.prescribed = prescribed(episode, space.path)
        self.least = episode.scenario.eta_max
        self.best: Hit | None = None
        self.hit: EpisodeSpec | None = None
        self.actions: IntArray | None = None
        self.tick = 0
        self.near_misses: list[NearMiss] = []
        self.driven = 0

    @property
    def is_done(self) -> bool:
        """Whether nothing less can be found."""
        return self.least <= ENOUGH

    def specification(self, candidate: Candidate) -> EpisodeSpec | None:
        """Return the episode that drives a candidate as far as it is of use; None: it cannot be better than the best.

        It is a replay, so any stack and any simulator can run it. The car starts as in the trial.
        """
        last = candidate.last_tick(self.least)
        if last < 0:
            return None
        path = candidate.positions[: last + 2]
        return replace(self.prescribed, safe_trajectory=Trajectory(path, self.episode.scenario.time_step))

    def learn(self, candidate: Candidate | None, log: EpisodeLog) -> bool:
        """Take note of what happened; tell whether it is a better hit. None: the log is a kamikaze's own."""
        self.driven += 1
        if log.outcome == Outcome.ABORTED:
            return False
        if log.hit:
            hit = hit_of(self.space.path, log)
            if hit.distance >= self.least - ENOUGH:
                return False
            self.best = replace(hit, gap=0.0) if hit.distance <= ENOUGH else hit
            self.least, self.hit = hit.distance, log.episode
            self.actions = None if candidate is None else candidate.actions
            self.tick = len(log.adversary) - 2
            self.near_misses = [one for one in self.near_misses if one.deviation < hit.distance]
            return True
        if candidate is not None and log.outcome != Outcome.COLLISION:
            self._note_near_miss(candidate, log)
        return False

    def take(self, other: Trial) -> None:
        """Take over what was found in a copy of this trial, if it is better."""
        if other.least < self.least:
            self.best, self.hit, self.least = other.best, other.hit, other.least
            self.actions, self.tick = other.actions, other.tick
            self.near_misses = [one for one in self.near_misses if one.deviation < self.least]

    def _note_near_miss(self, candidate: Candidate, log: EpisodeLog) -> None:
        clearance, tick = least_clearance(log)
        deviation = float(candidate.deviations[tick + 1])
        if clearance > _NEAR or deviation >= self.least:
            return
        if any(one.deviation <= deviation and one.clearance <= clearance for one in self.near_misses):
            return
        kept = [one for one in self.near_misses if one.deviation < deviation or one.clearance < clearance]
        kept.append(NearMiss(deviation, clearance, candidate.actions, tick))
        kept.sort(key=lambda one: one.deviation)
        self.near_misses = kept[-NEAR_MISSES:]


def prescribed(episode: EpisodeSpec, positions: FloatArray) -> EpisodeSpec:
    """Return the episode in which the road user follows positions (n × 2, m) under the draws of a trial."""
    car = replace(episode.scenario.car, meet_safe_trajectory=False, start_gap=episode.start_gap)
    path = Trajectory(positions, episode.scenario.time_step, name="candidate")
    started = replace(episode.scenario, car=car)
    return replace(episode, mode=Mode.REPLAY, scenario=started, safe_trajectory=path, public=episode.public_scenario)


def least_clearance(log: EpisodeLog) -> tuple[float, int]:
    """Return the least distance (m) between the moving car and the road user, and the tick in which it was."""
    scenario = log.episode.scenario
    users, cars = log.adversary, log.car
    if not scenario.road.straight:
        users = right_and_along(scenario.road.line, users)
        along = np.array([road_position(scenario.road.line, x, y)[0] for x, y in cars[:, :2].tolist()])
        cars = np.column_stack([np.zeros(len(cars)), along, cars[:, 2:]])
    share = _SUB_STEPS[:, None]
    offsets = users - cars[:, :2]
    across, ahead = ((1.0 - share) * offsets[:-1, axis] + share * offsets[1:, axis] for axis in (0, 1))
    speeds = (1.0 - share) * cars[:-1, 3] + share * cars[1:, 3]
    car = scenario.car
    beside = np.maximum(np.abs(across) - car.half_width, 0.0)
    beyond = np.maximum(np.maximum(ahead - car.front, -car.rear - ahead), 0.0)
    clearances = np.sqrt(beside**2 + beyond**2) - scenario.adversary.reach
    clearances = np.where(speeds >= scenario.collision.hit_speed, clearances, math.inf).min(axis=0)
    tick = int(np.argmin(clearances))
    return float(clearances[tick]), tick


def excursion(rng: np.random.Generator, ticks: int, end: int, as_phi: int, action_count: int) -> IntArray:
    """Return a sequence that follows φ up to a tick, takes an action for some ticks, and another or φ from then on."""
    found = np.full(ticks, as_phi, np.int64)
    leaves = int(rng.integers(end))
    first, second = int(rng.integers(action_count)), int(rng.integers(action_count))
    back = leaves + int(rng.choice((1, 2, 3, 4, 6, 8)))
    again = back + int(rng.choice((0, 0, 1, 2, 4, ticks)))
    found[leaves:back] = first
    found[back:again] = second
    return found


def changed(
    rng: np.random.Generator, actions: IntArray, tick: int, others: Sequence[IntArray], as_phi: int, action_count: int
) -> IntArray:
    """Return a sequence with one or two small changes before a tick, or with the end of another one.

    Args:
        rng: draws the changes.
        actions: the sequence.
        tick: after which changes hardly matter: that of its contact.
        others: sequences of other trials, at least one.
        as_phi: number of the action "as φ".
        action_count: how many actions there are.
    """
    found, ticks = actions.copy(), len(actions)
    end = min(ticks, tick + 2)
    for _ in range(2 if rng.random() < 0.4 else 1):
        at, length = int(rng.integers(end)), 1 + int(rng.integers(4))
        kind = int(rng.integers(6))
        if kind <= 1:
            found[at : at + length] = rng.integers(action_count)
        elif kind == 2:
            found[at : at + length] = as_phi
        elif kind == 3:
            found[at + 1 :] = found[at:-1].copy()
            if rng.random() < 0.5:
                found[at] = rng.integers(action_count)
        elif kind == 4:
            found[at:-1] = found[at + 1 :].copy()
        else:
            found[at:] = others[int(rng.integers(len(others)))][at:]
    return found
