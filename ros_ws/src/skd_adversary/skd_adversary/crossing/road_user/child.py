"""A child on foot, who runs but needs some steps to get going; docs/decisions.md says why these numbers."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from skd_adversary.crossing.road_user.walker import walker

ACCELERATION: Final = 2.0
"""m/s², in any direction: to start, to turn and to stop."""
ROAD_USER: Final = replace(
    walker("child", ACCELERATION, fastest=8.0, height=1.2),
    called={
        "carla": "walker.pedestrian.0011",
        "openscenario": "pedestrian",
        "osi": "TYPE_PEDESTRIAN",
        "commonroad": "pedestrian",
        "levelxdata": "pedestrian",
    },
)
