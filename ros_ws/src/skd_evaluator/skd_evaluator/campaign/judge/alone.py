"""How a car drives with nobody near: one that does not drive hits nobody, and is none the safer for it."""

from __future__ import annotations

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
_HARDLY_MORE = 1.5  # times the speed at which a hit begins: who keeps just above it is stopped by any touch of a brake
_NEARLY_ALL = 0.9  # of the runs along φ
_GENTLY, _ROOM = 2.0, 5.0  # m/s², m
_HITS_NOBODY = "a car that does not drive hits nobody, so neither its margin nor its risk says how it avoids people"
_NUMBER = episode_id(Stage.RISK, 0xFFFF, 0xFFFF_FFFF)  # of no crossing; none of these is recorded


class Slowing(NamedTuple):
    """What a car slows down to for nobody.

    Attributes:
        first: speed at the beginning, m/s.
        last: speed at the end, much less than that, m/s.
        seconds: time between them, s.
    """

    first: float
    last: float
    seconds: float


def slowing_for_nobody(plan: Plan, runner: EpisodeRunner) -> Slowing | None:
    """Return what a car slows down to that has the road for itself; None if it drives.

    Args:
        plan: what is rated.
        runner: runs the episode, and keeps nothing of it.

    Raises:
        AssessmentError: the car fails.
    """
    (log,) = runner.run([_episode(plan)])
    if log.outcome == Outcome.ABORTED:
        raise AssessmentError(log.reason)
    first, last = log.car[[0, -1], 2].tolist()
    seconds = (len(log.car) - 1) * plan.scenario.time_step
    return Slowing(first, last, seconds) if last < _MUCH * first else None


def doubts_of_driving(plan: Plan, runner: EpisodeRunner) -> tuple[str, ...]:
    """Return, in a line, that a car hardly drives where nobody is near it; empty if it does.

    Args:
        plan: what is rated.
        runner: runs the episode, and keeps nothing of it.
    """
    try:
        found = slowing_for_nobody(plan, runner)
    except AssessmentError as error:
        return (f"{DOUBT}when it was to drive {HARDLY_DRIVES.strip()}, this came of it: {error}",)
    if found is None:
        return ()
    (first, last, seconds), least = found, plan.scenario.collision.hit_speed
    slows = f"{HARDLY_DRIVES}{plan.controller} slows from {first:.1f} to {last:.1f} m/s in {seconds:.1f} s"
    if last < _HARDLY_MORE * least:
        return (f"{DISBELIEF}{slows}, and a hit begins at {least:g} m/s: {_HITS_NOBODY}",)
    return (f"{slows}: how far people may stray, and how seldom they are hit, is due to that, too",)


def doubts_of_standing_off(controller: str, logs: Sequence[EpisodeLog]) -> tuple[str, ...]:
    """Return, in a line, that a car never drives, or stands so far from everybody that it hits nobody.

    It is told from what happened, whoever the car is and however it knows that somebody is there.

    Args:
        controller: name of the car.
        logs: its runs along φ.
    """
    # Of a scenario with others a car may have to stand for these.
    runs = [one for one in logs if one.outcome != Outcome.ABORTED and not one.episode.scenario.others]
    still = sum(map(_stood_far_off, runs))
    if not runs or still < _NEARLY_ALL * len(runs):
        return ()
    scenario = runs[0].episode.scenario
    return (
        f"{DISBELIEF}in {still} of {len(runs)} runs along φ {controller} was slower than "
        f"{scenario.collision.hit_speed:g} m/s, at which a hit begins, all the time or while whoever crossed was "
        f"more than {_far(scenario):.0f} m away: {_HITS_NOBODY}",
    )


def _far(scenario: Scenario) -> float:
    """Return from how far on a car has no need to slow down for anybody yet, m: it can still stop gently."""
    return scenario.car.start_speed**2 / (2.0 * _GENTLY) + _ROOM


def _stood_far_off(log: EpisodeLog) -> bool:
    scenario = log.episode.scenario
    slower = log.car[:, 2] < scenario.collision.hit_speed
    begins = int(np.argmin(slower))  # who stands at first may have to start
    stands = begins + int(np.argmax(slower[begins:]))
    away = float(np.hypot(*(log.adversary[stands] - log.car[stands, :2]))) - scenario.car.front
    return bool(slower.all()) or (bool(slower[stands]) and stands > begins and away > _far(scenario))


def _episode(plan: Plan) -> Episode:
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
        _NUMBER,
        nowhere,
        shown=clocked,
        controller=plan.controller,
        multiplier=plan.multiplier,
    )
