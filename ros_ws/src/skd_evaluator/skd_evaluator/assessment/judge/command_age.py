"""How old a car's commands were when they moved the car, over the episodes of a campaign."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from skd_sim.world.episode import EpisodeLog, Outcome


def command_age(logs: Iterable[EpisodeLog]) -> dict[str, Any] | None:
    """Return the figures of episodes that ran to their end; None if nothing is known, as for episodes in process.

    Ages are s of wall time, over all control periods of all episodes; `held` counts the control periods for which no
    new command had come, and `greatest_delay` (s) is by how much the latest control period of real time was late.
    """
    timings = [log.timing for log in logs if log.outcome != Outcome.ABORTED and log.timing.ages]
    if not timings:
        return None
    ages = np.concatenate([timing.ages for timing in timings])
    median, late = np.percentile(ages, (50.0, 99.0))
    return {
        "median": float(median),
        "p99": float(late),
        "worst": float(ages.max()),
        "control_periods": len(ages),
        "held": sum(timing.held for timing in timings),
        "greatest_delay": max(timing.delay for timing in timings),
    }
