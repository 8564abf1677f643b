"""Whom the car touched in a collision, the adversary or one of the others, and how fast the two came together."""

from __future__ import annotations

import math

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.world.episode import EpisodeLog, Outcome
from skd_sim.world.state import RoadUserState

from skd_evaluator.metrics.contact_place import Pose, car_at_contact
from skd_evaluator.metrics.surrogate_measures import clearances
from skd_evaluator.metrics.surrogate_scenes import Scene

ADVERSARY = -1


def collision_partner(log: EpisodeLog) -> int | None:
    """Return who was touched: `ADVERSARY`, or the number of one of the others; None without a collision.

    It is the one who is nearest to the car at the impact, whose place within the tick is interpolated.
    """
    scenario = log.episode.scenario
    if log.outcome != Outcome.COLLISION:
        return None
    if not scenario.others:
        return ADVERSARY
    pose, share = car_at_contact(log)
    body = scenario.adversary
    apart = [_apart(log, pose, body.shape, log.trajectory.positions[-1], body.last_heading(log.adversary))]
    for other, (before, after) in zip(scenario.others, _others_in_last_tick(log), strict=True):
        state = before.moved(after, share * scenario.time_step)
        apart.append(_apart(log, pose, other.shape, np.array(state[:2]), state.heading))
    return int(np.argmin(apart)) - 1


def closing_speed(log: EpisodeLog) -> float:
    """Return the speed of the car relative to whom it touched, m/s; nan without a collision.

    Euro NCAP's impact speeds of pedestrians are the car's own; of two vehicles what counts is this.
    """
    who = collision_partner(log)
    if who is None:
        return math.nan
    heading = car_at_contact(log)[0][2]
    vx, vy = (log.adversary[-1] - log.adversary[-2]) / log.episode.scenario.time_step
    if who != ADVERSARY:
        vx, vy = _others_in_last_tick(log)[who][1][2:4]
    return math.hypot(log.impact_speed * math.cos(heading) - vx, log.impact_speed * math.sin(heading) - vy)


def speed_ahead(log: EpisodeLog) -> float:
    """Return how fast the adversary moves the way that the car points, when the two collide, m/s."""
    heading = car_at_contact(log)[0][2]
    vx, vy = (log.adversary[-1] - log.adversary[-2]) / log.episode.scenario.time_step
    return float(vx * math.cos(heading) + vy * math.sin(heading))


def _others_in_last_tick(log: EpisodeLog) -> list[tuple[RoadUserState, RoadUserState]]:
    """Return the states of each of the others when the last tick begins and when it ends."""
    scenario, tick = log.episode.scenario, len(log.adversary) - 2
    return list(zip(scenario.others_at(tick), scenario.others_at(tick + 1), strict=True))


def _apart(log: EpisodeLog, pose: Pose, shape: tuple[float, float, float], place: FloatArray, heading: float) -> float:
    """Return the distance of the car at a pose to somebody at a place (m) with a heading (rad), m."""
    car = log.episode.scenario.car
    footprint, nobody_moves = (car.front, car.rear, car.half_width), np.zeros((1, 2))
    states, turned = np.array([[*pose, 0.0]]), np.array([heading])
    return float(clearances(Scene(np.zeros(1), states, place[None], nobody_moves, turned, footprint, shape))[0])
