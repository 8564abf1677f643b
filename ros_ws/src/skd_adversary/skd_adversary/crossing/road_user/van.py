"""A delivery van: slower than a car to start and stop, in wider circles; docs/decisions.md says why these numbers."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

from skd_adversary.crossing.road_user.wheeled import Limits, wheeled

LIMITS: Final = Limits(acceleration=2.0, deceleration=5.0, lateral=3.5, turn=math.pi / 6.0, radius=6.5)
ROAD_USER: Final = replace(
    wheeled("van", LIMITS, fastest=50.0, height=2.4),
    called={
        "carla": "vehicle.mercedes.sprinter",
        "openscenario": "van",
        "osi": "TYPE_DELIVERY_VAN",
        "levelxdata": "van",
    },
)
