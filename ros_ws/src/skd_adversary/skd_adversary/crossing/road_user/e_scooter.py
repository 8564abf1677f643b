"""Somebody who stands on an electric scooter; docs/decisions.md says why these numbers."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

from skd_adversary.crossing.road_user.wheeled import Limits, wheeled

LIMITS: Final = Limits(acceleration=1.2, deceleration=3.5, lateral=2.5, turn=math.pi / 6.0, radius=0.0)
"""To the side a lean of 14°."""
ROAD_USER: Final = replace(
    wheeled("e_scooter", LIMITS, fastest=15.0, height=1.9),
    called={"openscenario": "bicycle", "osi": "TYPE_STANDUP_SCOOTER", "commonroad": "bicycle"},
)
