"""Required deceleration at entry: how hard a car would have had to brake when who is hit came into its way.

The deceleration rate to avoid the crash (Cooper and Ferguson, "Traffic studies at T-junctions. 2. A conflict simulation
record", Traffic Engineering and Control 17, 1976): Δv²/(2 d), with the speed Δv at which car and adversary come
together along the road and the gap d between the car's front and the adversary's nearest point along it. It is taken at
the first tick at which the adversary can reach into the strip that the car sweeps. Above some 8 m/s² on a dry road no
brake could have helped, so that such a collision says more of the adversary than of the car.

The greatest required deceleration of a whole episode is another figure (`measure.surrogate.braking`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from skd_sim.scenario.road import right_and_along
from skd_sim.world.episode import EpisodeLog
from skd_sim.world.state import Trajectory

from skd_evaluator.metrics.distances.measures import Measure, Pair


def deceleration_at_entry(log: EpisodeLog) -> float:
    """Return the deceleration (m/s²) that would have kept the car off, braking from when the adversary was in its way.

    Returns:
        0 where the two did not come together along the road then; nan where the adversary was in the way at no tick
        before the contact, or beside the car already.
    """
    scenario, step = log.episode.scenario, log.episode.scenario.time_step
    line = scenario.road.line
    before = int(np.ceil(log.impact_time / step))  # ticks from here on are not before the contact
    across, along = right_and_along(line, np.ascontiguousarray(log.adversary)).T
    (in_the_way,) = np.nonzero(np.abs(across[:before]) <= scenario.end.path_edge)
    if not len(in_the_way):
        return float("nan")
    tick = int(in_the_way[0])
    outline = scenario.adversary.outline(log.adversary[: tick + 1])
    front = right_and_along(line, np.ascontiguousarray(log.car[tick : tick + 1, :2]))[0, 1] + scenario.car.front
    gap = float(right_and_along(line, outline)[:, 1].min() - front)
    if gap <= 0.0:
        return float("nan")
    last = max(tick, 1)
    closing = float(log.car[tick, 2] - (along[last] - along[last - 1]) / step)
    return max(0.0, closing) ** 2 / (2.0 * gap)


def _of_pairs(_phi: Trajectory, pairs: Sequence[Pair]) -> list[float]:
    return [deceleration_at_entry(one.log) for one in pairs]


DECELERATION_AT_ENTRY = Measure("required deceleration at entry", "m/s²", _of_pairs)
