"""Time stamps of ticks: whole nanoseconds, so that the stamp of a tick is the same wherever it is computed."""

from __future__ import annotations

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


def stamp_fault(stamp: int, wanted: int) -> str:
    """Return what is wrong with the stamp (ns) of an answer to the state stamped `wanted` (ns), and what would help."""
    behind = (wanted - stamp) / NANOSECONDS
    if stamp == 0:
        return "they are not set: copy the odometry's stamp"
    if stamp > WALL_CLOCK:
        return "they are of the wall clock: set use_sim_time:=true, or copy the odometry's stamp"
    how = f"lag by {behind:.3g} s" if behind > 0.0 else f"are {-behind:.3g} s ahead"
    return f"they {how}: copy the odometry's stamp (and use_sim_time:=true where the node has a clock)"
