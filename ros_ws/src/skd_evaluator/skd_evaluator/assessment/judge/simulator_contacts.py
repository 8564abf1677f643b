"""What another simulator's own shapes say of contacts, beside SKD's geometry, by which contacts count."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, Final

from skd_sim.world.episode import EpisodeLog, Outcome

KEY: Final = "simulator_contacts"


def simulator_contacts(logs: Iterable[EpisodeLog]) -> dict[str, Any]:
    """Return the entry of assessment.json under its key; nothing where the simulator has no shapes of its own.

    Args:
        logs: episodes; aborted ones do not count.
    """
    asked = [log for log in logs if log.own_contact is not None and log.outcome != Outcome.ABORTED]
    if not asked:
        return {}
    pairs = [(log.impact_time, float(log.own_contact or 0.0)) for log in asked]
    found = [(not math.isnan(ours), not math.isnan(its)) for ours, its in pairs]
    gaps = [abs(ours - its) for ours, its in pairs if not math.isnan(ours - its)]
    return {
        KEY: {
            "both": found.count((True, True)),
            "geometry_alone": found.count((True, False)),
            "simulator_alone": found.count((False, True)),
            "episodes": len(asked),
            "greatest_gap": max(gaps, default=None),
        }
    }
