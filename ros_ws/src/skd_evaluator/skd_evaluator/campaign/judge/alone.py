"""How a car drives with nobody near: one that does not drive hits nobody, and is none the safer for it."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from skd_sim.controllers import with_control_period
from skd_sim.encounter.road import beside_road
from skd_sim.encounter.scenario import Scenario
from skd_sim.episode.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.geometry.trajectory import Trajectory

from skd_evaluator.campaign.plan.plan import EpisodeRunner, Plan, Stage, episode_id
from skd_evaluator.errors import AssessmentError
from skd_evaluator.measure.doubt import DISBELIEF, DOUBT, HARDLY_DRIVES

_FAR = 1000.0  # m up the road, and as many beside it
_SECONDS = 6.0  # in which a car of 60 km/h stops at 3 m/s²
_MUCH = 0.7  # share of its speed that a car keeps which nobody is in the way of
_CRAWLS = 0.35  # likewise, in a single drive: half of that, which no noise explains
_OFTEN = 0.25  # share of drives in which a car stands whose figures are those of how often it stands
_HARDLY_MORE = 1.5  # times the speed at which a hit begins: who keeps just above it is stopped by any touch of a brake
_NEARLY_ALL = 0.9  # of the runs along φ
_GENTLY, _ROOM = 2.0, 5.0  # m/s², m
_HITS_NOBODY = "a car that does not drive hits nobody, so neither its margin nor its risk says how it avoids people"
_LAST = 0xFFFF_FFFF  # number of no crossing; none of these is recorded


MANY_DRIVES = 20
"""Of a car with nobody near: one that stands in a tenth of its episodes, by lot, drives in all of these once in 8."""
FEW_DRIVES = 5
"""Likewise where each takes as long as it does on a road."""


class Drive(NamedTuple):
    """How a car drove with nobody near.

    Attributes:
        first: speed at the beginning, m/s.
        last: speed at the end, m/s.
        seconds: time between them, s.
    """

    first: float
    last: float
    seconds: float

    @property
    def kept(self) -> float:
        """Share of its speed that it kept; 1 of one that had none."""
        return self.last / self.first if self.first > 0.0 else 1.0

    @property
    def slows(self) -> bool:
        """Whether the car slowed down by much, with nobody in its way."""
        return self.kept < _MUCH


def drives_with_nobody_near(plan: Plan, runner: EpisodeRunner, count: int) -> list[Drive]:
    """Return how a car drives that has the road for itself, the slowest first.

    Each is an episode of its own: its noise, and the generator that a controller is handed, differ from the others'.

    Args:
        plan: what is rated.
        runner: runs the episodes, and keeps nothing of them.
        count: how many drives.

    Raises:
        AssessmentError: the car fails.
    """
    found = []
    for log in runner.run([_episode(plan, number) for number in range(count)]):
        if log.outcome == Outcome.ABORTED:
            raise AssessmentError(log.reason)
        first, last = log.car[[0, -1], 2].tolist()
        found.append(Drive(first, last, (len(log.car) - 1) * plan.scenario.time_step))
    return sorted(found, key=lambda drive: drive.kept)


def doubts_of_driving(plan: Plan, runner: EpisodeRunner, count: int = MANY_DRIVES) -> tuple[str, ...]:
    """Return, in a line, that a car hardly drives where nobody is near it, always or now and then; empty if it drives.

    Now and then counts too: a car that stands in a quarter of its episodes, by lot, hits a quarter fewer.

    Args:
        plan: what is rated.
        runner: runs the episodes, and keeps nothing of them.
        count: how many drives.
    """
    try:
        drives = drives_with_nobody_near(plan, runner, count)
    except AssessmentError as error:
        return (f"{DOUBT}when it was to drive {HARDLY_DRIVES.strip()}, this came of it: {error}",)
    least = plan.scenario.collision.hit_speed
    standing = [drive for drive in drives if drive.slows and drive.last < _HARDLY_MORE * least]
    if standing:
        begins = f"{_slows(plan, standing, count)}, and a hit begins at {least:g} m/s: "
        if len(standing) > _OFTEN * count:
            return (f"{DISBELIEF}{begins}{_HITS_NOBODY}",)
        return (f"{DOUBT}{begins}{_HITS_NOBODY}",)
    crawling = [drive for drive in drives if drive.kept < _CRAWLS]
    if statistics.median(drive.kept for drive in drives) < _MUCH:
        crawling = [drive for drive in drives if drive.slows]
    if not crawling:
        return ()
    slows = _slows(plan, crawling, count)
    return (f"{slows}: how far people may stray, and how seldom they are hit, is due to that, too",)


def _slows(plan: Plan, drives: Sequence[Drive], count: int) -> str:
    """Return, as the beginning of a line, how a car slows down in some of its drives."""
    first, last, seconds = drives[len(drives) // 2]
    often = "" if len(drives) == count else f" in {len(drives)} of {count} drives"
    return f"{HARDLY_DRIVES}{plan.controller} slows from {first:.1f} to {last:.1f} m/s in {seconds:.1f} s{often}"


def doubts_of_standing_off(controller: str, logs: Sequence[EpisodeLog]) -> tuple[str, ...]:
    """Return, in a line, that a car never drives, or stands so far from everybody that it hits nobody.

    It is told from what happened, whoever the car is and however it knows that somebody is there.

    Args:
        controller: name of the car.
        logs: its runs along φ.
    """
    runs = [one for one in logs if one.outcome != Outcome.ABORTED]
    still = sum(map(_stood_far_off, runs))
    if not runs or still < _NEARLY_ALL * len(runs):
        return ()
    scenario = runs[0].episode.scenario
    return (
        f"{DISBELIEF}in {still} of {len(runs)} runs along φ {controller} was slower than "
        f"{scenario.collision.hit_speed:g} m/s, at which a hit begins, all the time or while everybody was "
        f"more than {_far(scenario):.0f} m away: {_HITS_NOBODY}",
    )


def _far(scenario: Scenario) -> float:
    """Return from how far on a car has no need to slow down for anybody yet, m: it can still stop gently."""
    return scenario.car.start_speed**2 / (2.0 * _GENTLY) + _ROOM


def _stood_far_off(log: EpisodeLog) -> bool:
    if log.hit:  # it drove on
        return False
    scenario = log.episode.scenario
    slower = log.car[:, 2] < scenario.collision.hit_speed
    if slower.all():
        return _nearest_other(log, 0) > _far(scenario)
    begins = int(np.argmin(slower))  # who stands at first may have to start
    stands = begins + int(np.argmax(slower[begins:]))
    away = float(np.hypot(*(log.adversary[stands] - log.car[stands, :2])))
    away = min(away - scenario.car.front - scenario.adversary.reach, _nearest_other(log, stands))
    return bool(slower[stands]) and stands > begins and away > _far(scenario)


def _nearest_other(log: EpisodeLog, tick: int) -> float:
    """Return how far the nearest of a scenario's others is at a tick, m; a car may have to stand for it."""
    scenario, (x, y, *_) = log.episode.scenario, log.car[tick]
    others = zip(scenario.others, scenario.others_at(tick), strict=True)
    away = [math.hypot(state.x - x, state.y - y) - other.reach for other, state in others]
    return min(away, default=math.inf) - scenario.car.front


def _episode(plan: Plan, number: int) -> Episode:
    """Return an episode in which nobody is on the road, and somebody stands a kilometre away."""
    clocked = with_control_period(plan.scenario, plan.car.control_period, plan.controller)
    scenario = replace(clocked, car=replace(clocked.car, meet_safe_trajectory=False), others=())
    ticks = min(scenario.ticks, round(_SECONDS / scenario.time_step))
    away = np.tile([-_FAR * scenario.end.crossing, _FAR], (ticks + 1, 1))
    nowhere = Trajectory(beside_road(scenario.road.line, away), scenario.time_step, "nobody near")
    return Episode(
        scenario,
        Mode.REPLAY,
        plan.seed,
        episode_id(Stage.RISK, 0xFFFF, _LAST - number),
        nowhere,
        shown=clocked,
        controller=plan.controller,
        multiplier=plan.multiplier,
    )
