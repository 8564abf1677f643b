"""Whether an adversary chooses among a few listed actions, or draws what it tries. Light, as `objective`."""

from __future__ import annotations

from enum import StrEnum


class Actions(StrEnum):
    """What a kamikaze's planner tries."""

    LISTED = "listed"  # those of its kind of road user, such as the pedestrian's six
    DRAWN = "drawn"  # velocities from all that its kind can do
