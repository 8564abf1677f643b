"""Whether an adversary did what it plans: the decisions of a recorded kamikaze, made again.

What an adversary decides follows from the episode's specification, whose seed gives every draw, and from where the car
was at each tick. It carries its belief from tick to tick, so an episode is decided again from its first one. What it
did otherwise was decided by something else: by fewer simulations, another objective, or by nobody.
"""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

import numpy as np
from skd_adversary.adversary import make_adversary
from skd_sim.choices.knowledge import Knowledge
from skd_sim.encounter.road import HEADING_NORTH
from skd_sim.episode.episode import EpisodeLog
from skd_sim.errors import UsageError
from skd_sim.state import CarState

from skd_evaluator.campaign.validation.recomputation import ROUNDING
from skd_evaluator.campaign.validation.verdict import examine

Velocity = tuple[float, float]


class Unverified(StrEnum):
    """Why nothing can be said of an episode's decisions."""

    ITSELF = "knowledge itself: they were planned with copies of the car, which is not there"
    ELSEWHERE = "another simulator moved the adversary"
    LATE = "commands of earlier ticks were obeyed, as in real time"
    ROUNDED = "recorded where numbers are rounded otherwise"
    VERSION = "another version of SKD has planned them"
    DISTANCE = "--max-distance of a replay is another than they were planned with"
    UNKNOWN = "not everything that they were planned with is there"


class Otherwise(NamedTuple):
    """The first tick at which an adversary did what it does not plan.

    Attributes:
        tick: number of it.
        recorded: velocity over the tick, (East, North), m/s.
        planned: that follows from the specification and from where the car was, m/s.
    """

    tick: int
    recorded: Velocity
    planned: Velocity


Decided = Otherwise | Unverified | None
"""What came of deciding again; None: all of it was planned as the specification says."""


def decide_again(log: EpisodeLog) -> Decided:
    """Make the decisions of a kamikaze again, from its first tick on, and compare them with what was recorded.

    Args:
        log: of a kamikaze that can have happened, from whatever file.
    """
    if log.episode.knowledge == Knowledge.ITSELF:
        return Unverified.ITSELF
    verdict = examine(log)
    if not verdict.ours:
        return Unverified.ELSEWHERE
    try:
        otherwise, late = _compare(log)
    except UsageError:  # an objective that is not installed here, no car model
        return Unverified.UNKNOWN
    if otherwise is not None:
        return otherwise if verdict.rounded == 0.0 else Unverified.ROUNDED
    return Unverified.LATE if late else None


def _compare(log: EpisodeLog) -> tuple[Otherwise | None, bool]:
    """Return where the adversary first did what it had not planned, and whether it did anything late before.

    In real time a command is held until the next one comes: what was planned for an earlier tick is late, no more.
    """
    adversary = make_adversary(log.episode)
    real_time = log.timing.delay > 0.0  # lockstep waits for each command
    step = log.episode.scenario.time_step
    planned: list[Velocity] = []
    late = False
    for tick, (x, y, speed) in enumerate(log.car[:-1].tolist()):
        planned.append(adversary.act(CarState(x, y, HEADING_NORTH, speed)))
        here, there = log.adversary[tick], log.adversary[tick + 1]
        far = np.abs(here + step * np.array(planned) - there).max(axis=1)
        if far[-1] <= ROUNDING:
            continue
        if not real_time or far.min() > ROUNDING:
            vx, vy = ((there - here) / step).tolist()
            return Otherwise(tick, (vx, vy), planned[-1]), late
        late = True
    return None, late
