"""A motorcycle with its rider: what most riders reach on a dry road; docs/decisions.md says why these numbers."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

from skd_adversary.crossing.road_user.wheeled import Limits, wheeled

LIMITS: Final = Limits(acceleration=4.0, deceleration=5.5, lateral=4.0, turn=math.pi / 6.0, radius=2.5)
"""To the side a lean of 22°."""
ROAD_USER: Final = replace(
    wheeled("motorcycle", LIMITS, fastest=85.0, height=1.5),
    called={
        "carla": "vehicle.kawasaki.ninja",
        "metadrive": "CYCLIST",
        "openscenario": "motorbike",
        "osi": "TYPE_MOTORBIKE",
        "commonroad": "motorcycle",
        "levelxdata": "motorcycle",
    },
)
