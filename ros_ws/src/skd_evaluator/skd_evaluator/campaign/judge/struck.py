"""Whom the car touched in a collision, the adversary or one of the others, and how fast the two came together."""

from __future__ import annotations

import math

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.episode.episode import EpisodeLog, Outcome
from skd_sim.geometry.contact import rectangle_distance, to_car_frame
from skd_sim.state import RoadUserState

from skd_evaluator.measure.contact_place import car_at_contact

ADVERSARY = -1
_PER_EDGE = 40
"""Points of an edge of an outline that are held against the car."""


def struck(log: EpisodeLog) -> int | None:
    """Return who was touched: `ADVERSARY`, or the number of one of the others; None without a collision.

    It is the one who is nearest to the car at the impact, whose place within the tick is interpolated.
    """
    scenario = log.episode.scenario
    if log.outcome != Outcome.COLLISION:
        return None
    if not scenario.others:
        return ADVERSARY
    pose, share = car_at_contact(log)
    outlines = [scenario.adversary.outline(log.trajectory.positions)]
    for other, (before, after) in zip(scenario.others, _others_in_last_tick(log), strict=True):
        state = before.moved(after, share * scenario.time_step)
        outlines.append(other.outline_at(np.array(state[:2]), state.heading))
    return int(np.argmin([_away(log, outline, pose) for outline in outlines])) - 1


def closing_speed(log: EpisodeLog) -> float:
    """Return the speed of the car relative to whom it touched, m/s; nan without a collision.

    Euro NCAP's impact speeds of pedestrians are the car's own; of two vehicles what counts is this.
    """
    who = struck(log)
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


def _away(log: EpisodeLog, outline: FloatArray, pose: tuple[float, float, float]) -> float:
    """Return the distance (m) of an outline (k × 2, m) to the car's footprint at a pose (m, rad)."""
    car, shares = log.episode.scenario.car, np.linspace(0.0, 1.0, _PER_EDGE)[:, None]
    points = [one + shares * (other - one) for one, other in zip(outline, np.roll(outline, -1, axis=0), strict=True)]
    seen = (to_car_frame(float(x), float(y), *pose) for x, y in np.concatenate(points).tolist())
    return min(float(rectangle_distance(*here, car.front, car.rear, car.half_width)) for here in seen)
