"""What the keys of a scenario's file may be: annotations of its dataclasses, read by `skd_sim.encounter.reader`."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Range:
    """What a number may be; the annotation of every numeric key."""

    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Choice:
    """What a text may be; the annotation of a key that names one of several ways."""

    names: tuple[str, ...]


ON_LANE = ("lane", "along", "aside")
"""Keys that say where something is by a lane of the road, in place of its coordinates (skd_sim/encounter/lanes.py)."""
