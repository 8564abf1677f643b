"""Names of the coordinate frames that messages carry: `map` → `odom` → `base_link` → `laser` (REP 105)."""

from __future__ import annotations

from typing import NamedTuple

MAP_FRAME = "map"
"""The world frame: ENU (REP 103), with the crossing point as its origin."""
ADVERSARY_FRAME = "adversary"
"""The adversary's own frame; no transform leads to it, for it is the truth about somebody else."""


class Frames(NamedTuple):
    """Frames of the car under test.

    Attributes:
        odom: frame of the odometry. It coincides with `map`, since the odometry is exact and does not drift.
        base: frame of the car's body, at its reference point, on the ground, x ahead.
        laser: frame of the laser scanner.
    """

    odom: str = "odom"
    base: str = "base_link"
    laser: str = "laser"


FRAMES = Frames()
"""What most stacks call them."""
