"""The cyclist: what an unhurried rider can do on a dry road; docs/decisions.md says why these numbers."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

from skd_adversary.crossing.road_user.wheeled import Limits, wheeled

LIMITS: Final = Limits(acceleration=1.0, deceleration=3.0, lateral=3.0, turn=math.pi / 6.0, radius=0.0)
"""To the side a lean of 17°."""
ROAD_USER: Final = replace(
    wheeled("cyclist", LIMITS, fastest=20.0, height=1.8),
    called={
        "carla": "vehicle.diamondback.century",
        "metadrive": "CYCLIST",
        "openscenario": "bicycle",
        "osi": "TYPE_BICYCLE",
        "commonroad": "bicycle",
        "levelxdata": "bicycle",
    },
)
