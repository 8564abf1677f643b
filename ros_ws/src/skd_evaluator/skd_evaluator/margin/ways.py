"""What the adversary of the margin can do in a tick, in one place: its ways.

A pedestrian takes the planner's six actions (ways 0 … 5), goes as φ (way 6, `AS_PHI`) or takes one of the five
directions at half speed (ways 7 … 11). As φ is the displacement that φ makes in the tick, none after φ's end, whatever
its pace: somebody has walked so.

A road user with a state of its own, as the cyclist, has its own actions from that state, at no half speed, for its
speed is part of the state; as φ it goes as far as it can: at the velocity that is nearest to φ's among its actions' and
those between them. Whoever has been as φ so far can go on so.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
from skd_adversary.model.road_user import pedestrian
from skd_adversary.model.road_user.pedestrian import ACTION_COUNT, AS_PHI, STAY, action_velocity
from skd_adversary.model.road_users import road_user_named
from skd_adversary.model.safe_path import path_velocity
from skd_sim.compilation import kernel
from skd_sim.encounter.scenario import Scenario

FloatArray = npt.NDArray[np.float64]

FIRST_HALF: Final = AS_PHI + 1
"""Way FIRST_HALF + a is action a at half speed."""
WAY_COUNT: Final = FIRST_HALF + STAY
"""Of a pedestrian: 12."""
HALF: Final = 0.5
"""Of the full speed: of somebody who hesitates."""
_SAME = 1e-9  # m, within which a way so far is φ's

assert STAY == ACTION_COUNT - 1  # all actions but the last have a direction, and so a half speed


@kernel(inline=True)
def way_velocity(way: int, path: FloatArray, tick: int, time_step: float, speed: float) -> tuple[float, float]:
    """Return a pedestrian's velocity (East, North), m/s, in a way.

    Args:
        way: 0 … WAY_COUNT − 1.
        path: φ, n × 2, m.
        tick: ≥ 0, in which it is gone.
        time_step: s.
        speed: of the pedestrian, m/s.
    """
    if way == AS_PHI:
        return path_velocity(path, tick, time_step)
    if way > AS_PHI:
        return action_velocity(way - FIRST_HALF, HALF * speed)
    return action_velocity(way, speed)


def velocities(scenario: Scenario, path: FloatArray, tick: int, walked: FloatArray | None = None) -> FloatArray:
    """Return the velocities of all ways in a tick.

    Args:
        scenario: names the road user and its speed.
        path: φ, n × 2, m.
        tick: ≥ 0.
        walked: where the adversary has been, at ticks 0 … tick, (tick + 1) × 2, m; of no account for a pedestrian.

    Returns:
        k × 2, (East, North), m/s; of a pedestrian k is WAY_COUNT. Several may be the same.

    Raises:
        ValueError: where a road user with a state of its own has been is not given, or not for as many ticks.
    """
    step = scenario.time_step
    user = road_user_named(scenario.pedestrian.kind)
    if user is pedestrian.ROAD_USER:
        speed = scenario.pedestrian.speed
        return np.array([way_velocity(way, path, tick, step, speed) for way in range(WAY_COUNT)])
    if walked is None or len(walked) != tick + 1:
        raise ValueError(f"what a {user.name} can do at tick {tick} depends on the {tick + 1} places where it has been")
    own = np.asarray(user.choices(scenario, path, np.vstack([walked, walked[-1:]]))[tick], dtype=np.float64)
    as_phi = np.array(path_velocity(path, tick, step))
    held = path[np.minimum(np.arange(tick + 1), len(path) - 1)]
    if float(np.max(np.abs(walked - held))) > _SAME:
        as_phi = _nearest_between(own, as_phi)
    return np.vstack([own, as_phi])


def _nearest_between(own: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return the point nearest to `wanted` (2) in the convex hull of points (k × 2).

    Every point of a planar hull lies in a triangle of three of the points; k is small, so all of them are looked at.
    """
    best, least = own[0], np.inf
    count = len(own)
    for i in range(count):
        for j in range(i, count):
            along = own[j] - own[i]
            squared = float(along @ along)
            share = float(np.clip((wanted - own[i]) @ along / squared, 0.0, 1.0)) if squared > 0.0 else 0.0
            point = own[i] + share * along
            away = float((wanted - point) @ (wanted - point))
            if away < least:
                best, least = point, away
            for k in range(j + 1, count):
                if _inside(own[i], own[j], own[k], wanted):
                    return wanted
    return np.asarray(best)


def _inside(a: FloatArray, b: FloatArray, c: FloatArray, point: FloatArray) -> bool:
    sides = [
        float((q[0] - p[0]) * (point[1] - p[1]) - (q[1] - p[1]) * (point[0] - p[0]))
        for p, q in ((a, b), (b, c), (c, a))
    ]
    return (min(sides) >= 0.0 or max(sides) <= 0.0) and any(side != 0.0 for side in sides)
