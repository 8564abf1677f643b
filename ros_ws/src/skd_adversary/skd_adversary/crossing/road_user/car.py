"""Another car: what a driver does on a dry road without skidding; docs/decisions.md says why these numbers."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

from skd_adversary.crossing.road_user.wheeled import Limits, wheeled

LIMITS: Final = Limits(acceleration=2.5, deceleration=6.0, lateral=4.0, turn=math.pi / 6.0, radius=5.5)
ROAD_USER: Final = replace(
    wheeled("car", LIMITS, fastest=70.0, height=1.5),
    called={
        "carla": "vehicle.tesla.model3",
        "metadrive": "VEHICLE",
        "openscenario": "car",
        "osi": "TYPE_MEDIUM_CAR",
        "commonroad": "car",
        "levelxdata": "car",
    },
)
