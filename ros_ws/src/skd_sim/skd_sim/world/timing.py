"""Time stamps of ticks, and how old a car's commands are when the car is moved by them. Without ROS.

The age of a command at use is the wall time from the publication of the state that its stamp names to the moment at
which the simulator moves the car by it: how old the world is that the decision was made on. Stamps between two states
name the earlier one. A command without a stamp, or with one of another clock, is as old as its arrival. Who waits for
the command, as lockstep does, uses it when it comes, so there the age is the time in which the car answers.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import NamedTuple

NANOSECONDS = 1_000_000_000
WALL_CLOCK = 1_000_000_000 * NANOSECONDS
"""Stamps after this one, in September 2001, are not of a simulation that begins at 0."""


def tick_stamp(start: int, tick: int, time_step: float) -> int:
    """Return the stamp (ns) of a tick of an episode that starts at `start` (ns), at `time_step` (s)."""
    return start + round(tick * time_step * NANOSECONDS)


def period_stamp(start: int, tick: int, period: int, periods: int, time_step: float) -> int:
    """Return the stamp (ns) of control period `period` of a tick that has `periods`; that of period 0 is the tick's."""
    return start + round((tick + period / periods) * time_step * NANOSECONDS)


def period_of(stamp: int, start: int, time_step: float, periods: int = 1) -> tuple[int, int] | None:
    """Return the tick and the control period in it that have exactly this stamp (ns), or none."""
    tick, period = divmod(round((stamp - start) * periods / (time_step * NANOSECONDS)), periods)
    return (tick, period) if tick >= 0 and period_stamp(start, tick, period, periods, time_step) == stamp else None


def next_start(end: int) -> int:
    """Return the start (ns) of the episode after one that ended at `end` (ns): a whole second, at least one later.

    Simulation time never runs backwards, so stamps are unique in a campaign.
    """
    return (-(-end // NANOSECONDS) + 1) * NANOSECONDS


def stamp_fault(stamp: int, expected: int) -> str:
    """Return what is wrong with the stamp (ns) of an answer to the state of another (ns), and what would help."""
    behind = (expected - stamp) / NANOSECONDS
    if stamp == 0:
        return f"are not set: copy the odometry's stamp, or {_ANY_STAMP}"
    if stamp > WALL_CLOCK:
        return f"are of the wall clock: set use_sim_time:=true, copy the odometry's stamp, or {_ANY_STAMP}"
    how = f"lag by {behind:.3g} s" if behind > 0.0 else f"are {-behind:.3g} s ahead"
    return f"{how}: copy the odometry's stamp, or, of a node with a timer, use_sim_time:=true and {_ANY_STAMP}"


_ANY_STAMP = "-p quiet_time:=0.1, or --pacing real_time"


class Timing(NamedTuple):
    """How punctual an episode was, in wall time; not known for episodes in process and old recordings.

    Attributes:
        ages: age of the command that each control period used, s.
        held: number of control periods for which no new command had come.
        delay: how late the latest control period of real time came, s.
    """

    ages: tuple[float, ...] = ()
    held: int = 0
    delay: float = 0.0


UNTIMED = Timing()
"""Of an episode of which nothing is known."""


class CommandAges:
    """The ages in one episode after another.

    Attributes:
        ages: age of the command in each control period so far, s.
        held: number of control periods for which no command had come since the one before; they use the last command
            again.
    """

    def __init__(self, *, waited_for: bool) -> None:
        """Know nothing yet; `waited_for`: a command is used when it comes, not when it is time."""
        self._waited_for = waited_for
        self.begin()

    def begin(self) -> None:
        """Forget the last episode."""
        self.ages: list[float] = []
        self.held = 0
        self._stamps: list[int] = []
        self._published: list[float] = []
        self._source = self._came = math.nan
        self._fresh = False

    def publish(self, stamp: int, now: float) -> None:
        """Take note of a state with a stamp (ns), published at a monotonic time (s); one may be repeated."""
        if self._stamps and self._stamps[-1] == stamp:
            self._published[-1] = now
        else:
            self._stamps.append(stamp)
            self._published.append(now)

    def come(self, stamp: int | None, now: float) -> None:
        """Take note of a command that counts, with its stamp (ns) if it has one, at a monotonic time (s)."""
        self._came, self._fresh = now, True
        place = 0 if stamp is None or stamp > self._stamps[-1] else bisect_right(self._stamps, stamp)
        if place:
            self._source = self._published[place - 1]
        else:
            self._source = self._published[-1] if self._waited_for else now

    def use(self, now: float) -> None:
        """Take note of a control period that begins, at a monotonic time (s), with the last command that came."""
        self.held += not self._fresh
        self.ages.append((self._came if self._fresh and self._waited_for else now) - self._source)
        self._fresh = False


class Schedule:
    """When the control periods of real time are due: every so often from the start on.

    Attributes:
        period: wall time, s.
        worst: how much later than due the latest of them came, s.
    """

    def __init__(self, start: float, period: float) -> None:
        """Begin.

        Args:
            start: monotonic time, s; the first one is due a period later.
            period: wall time, s.
        """
        self.period = period
        self._due = start + period
        self.worst = 0.0

    def late(self, now: float) -> float:
        """Take note of a control period that begins at a monotonic time (s), and return how late it is, s.

        One that comes more than a period late takes the place of those that it has missed, as timers have it.
        """
        late = now - self._due
        self.worst = max(self.worst, late)
        self._due += self.period * (1 + max(0, math.floor(late / self.period)))
        return late
