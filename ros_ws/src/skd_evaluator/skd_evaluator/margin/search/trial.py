"""One trial of a margin, a nominal trajectory φ and a set of draws: the best hit among candidates that were driven."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from skd_sim.arrays import FloatArray, IntArray
from skd_sim.scenario.road import right_and_along, road_position
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome
from skd_sim.world.state import Trajectory

from skd_evaluator.margin.search.candidates import ENOUGH, ActionSpace, Candidate
from skd_evaluator.metrics.deviation import Hit, hit_of

NEAR_MISSES = 8
"""Kept for each trial."""
_NEAR = 2.0  # m between car and road user, below which a candidate is a near miss
_SUB_STEPS = np.array([0.25, 0.5, 0.75, 1.0])  # of a tick at which the clearance is looked at


class NearMiss(NamedTuple):
    """A candidate that was driven and nearly hit.

    Attributes:
        deviation: up to the moment of least clearance, m.
        clearance: least distance between the moving car and the road user, m.
        actions: number of the action in each tick.
        tick: of least clearance.
        log: what happened.
    """

    deviation: float
    clearance: float
    actions: IntArray
    tick: int
    log: EpisodeLog


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
        log: what happened then.
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
        self.log: EpisodeLog | None = None
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
            self.tick, self.log = len(log.adversary) - 2, log
            self.near_misses = [one for one in self.near_misses if one.deviation < hit.distance]
            return True
        if candidate is not None and log.outcome != Outcome.COLLISION:
            self._note_near_miss(candidate, log)
        return False

    def take(self, other: Trial) -> None:
        """Take over what was found in a copy of this trial, if it is better."""
        if other.least < self.least:
            self.best, self.hit, self.least = other.best, other.hit, other.least
            self.actions, self.tick, self.log = other.actions, other.tick, other.log
            self.near_misses = [one for one in self.near_misses if one.deviation < self.least]

    def _note_near_miss(self, candidate: Candidate, log: EpisodeLog) -> None:
        clearance, tick = least_clearance(log)
        deviation = float(candidate.deviations[tick + 1])
        if clearance > _NEAR or deviation >= self.least:
            return
        if any(one.deviation <= deviation and one.clearance <= clearance for one in self.near_misses):
            return
        kept = [one for one in self.near_misses if one.deviation < deviation or one.clearance < clearance]
        kept.append(NearMiss(deviation, clearance, candidate.actions, tick, log))
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
