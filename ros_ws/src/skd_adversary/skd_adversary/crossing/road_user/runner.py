"""Somebody who runs: starts, turns and stops faster than a child; docs/decisions.md says why these numbers."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from skd_adversary.crossing.road_user.walker import walker

ACCELERATION: Final = 3.0
"""m/s², in any direction: to start, to turn and to stop."""
ROAD_USER: Final = replace(
    walker("runner", ACCELERATION, fastest=12.0, height=1.8),
    called={
        "carla": "walker.pedestrian.0001",
        "openscenario": "pedestrian",
        "osi": "TYPE_PEDESTRIAN",
        "commonroad": "pedestrian",
        "levelxdata": "pedestrian",
    },
)
