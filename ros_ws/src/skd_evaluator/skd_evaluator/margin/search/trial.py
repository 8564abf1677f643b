"""One trial of a margin, a nominal trajectory φ and a set of draws: the best hit among candidates that were driven."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

from skd_sim.kernels.compilation import kernel
from skd_sim.world.contact import rectangle_distance, to_car_frame
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome
from skd_sim.world.state import FloatArray, IntArray, Trajectory

from skd_evaluator.margin.search.candidates import ENOUGH, ActionSpace, Candidate
from skd_evaluator.metrics.deviation import Hit, hit_of

NEAR_MISSES = 8
"""Kept for each trial."""
_NEAR = 2.0  # m between car and road user, below which a candidate is a near miss
_PARTS = 4  # of a tick at whose ends the clearance is looked at


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
        goal: how many candidates it is to be searched with.
        driven: how many candidates were driven.
        spent: the same, and how often none came to mind.
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
        self.goal = self.driven = self.spent = 0

    @property
    def is_done(self) -> bool:
        """Whether nothing less can be found."""
        return self.least <= ENOUGH

    def path(self, candidate: Candidate) -> FloatArray | None:
        """Return a candidate as far as it is of use, n × 2, m; None: it cannot be better than the best."""
        last = candidate.last_tick(self.least)
        return None if last < 0 else candidate.positions[: last + 2]

    def specification(self, path: FloatArray) -> EpisodeSpec:
        """Return the episode in which the road user follows a path (n × 2, m); the car starts as in the trial.

        It is a replay, so any stack and any simulator can run it.
        """
        return replace(self.prescribed, safe_trajectory=Trajectory(path, self.episode.scenario.time_step))

    def learn(self, candidate: Candidate | None, log: EpisodeLog) -> bool:
        """Take note of what happened; tell whether it is a better hit. None: the log is a kamikaze's own."""
        self.driven += 1
        self.spent += 1
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

    def _note_near_miss(self, candidate: Candidate, log: EpisodeLog) -> None:
        scenario = self.episode.scenario
        car, hit_speed = scenario.car, scenario.collision.hit_speed
        footprint = car.front, car.rear, car.half_width
        clearance, tick = least_clearance(log.adversary, log.car, footprint, scenario.adversary.reach, hit_speed)
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


@kernel
def least_clearance(
    users: FloatArray,
    cars: FloatArray,
    footprint: tuple[float, float, float],
    reach: float,
    hit_speed: float,
) -> tuple[float, int]:
    """Return the least distance (m) between the moving car and the road user, and the tick in which it was.

    Args:
        users: places of the road user at ticks, n × 2, m.
        cars: pose and speed of the car at ticks, n × 4.
        footprint: front, rear and half width of the car, m.
        reach: radius of the road user, m.
        hit_speed: speed of the car below which it does not count, m/s.
    """
    least, nearest = math.inf, 0
    ahead, left = to_car_frame(users[0, 0], users[0, 1], cars[0, 0], cars[0, 1], cars[0, 2])
    for tick in range(users.shape[0] - 1):
        after, at = cars[tick + 1], users[tick + 1]
        ahead_to, left_to = to_car_frame(at[0], at[1], after[0], after[1], after[2])
        for part in range(1, _PARTS + 1):
            share = part / _PARTS
            if (1.0 - share) * cars[tick, 3] + share * after[3] < hit_speed:
                continue
            along, aside = (1.0 - share) * ahead + share * ahead_to, (1.0 - share) * left + share * left_to
            clearance = rectangle_distance(along, aside, *footprint) - reach
            if clearance < least:
                least, nearest = clearance, tick
        ahead, left = ahead_to, left_to
    return least, nearest
