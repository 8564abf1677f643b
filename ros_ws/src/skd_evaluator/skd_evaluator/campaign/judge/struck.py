"""Whom the car touched in a collision: the adversary, or one of the others of the scenario."""

from __future__ import annotations

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.encounter.road import road_pose, road_position
from skd_sim.episode.episode import EpisodeLog, Outcome
from skd_sim.geometry.contact import rectangle_distance, to_car_frame

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
    tick = len(log.adversary) - 2
    share = log.impact_time / scenario.time_step - tick
    x, y = log.car[-2, :2] + share * (log.car[-1, :2] - log.car[-2, :2])
    line = scenario.road.line
    pose = road_pose(line, road_position(line, x, y)[0])
    ways = zip(scenario.others_at(tick), scenario.others_at(tick + 1), strict=True)
    states = [before.moved(after, share * scenario.time_step) for before, after in ways]
    outlines = [scenario.adversary.outline(log.trajectory.positions)]
    outlines += [
        other.outline_at(np.array(state[:2]), state.heading)
        for other, state in zip(scenario.others, states, strict=True)
    ]
    return int(np.argmin([_away(log, outline, pose) for outline in outlines])) - 1


def _away(log: EpisodeLog, outline: FloatArray, pose: tuple[float, float, float]) -> float:
    """Return the distance (m) of an outline (k × 2, m) to the car's footprint at a pose (m, rad)."""
    car, shares = log.episode.scenario.car, np.linspace(0.0, 1.0, _PER_EDGE)[:, None]
    points = [one + shares * (other - one) for one, other in zip(outline, np.roll(outline, -1, axis=0), strict=True)]
    seen = (to_car_frame(float(x), float(y), *pose) for x, y in np.concatenate(points).tolist())
    return min(float(rectangle_distance(*here, car.front, car.rear, car.half_width)) for here in seen)
