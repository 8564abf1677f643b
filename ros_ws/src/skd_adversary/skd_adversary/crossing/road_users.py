"""The kinds of road user that the adversary can be, and where a kind is looked up by its name.

SKD's own stand here, each with its limits (docs/decisions.md says why these numbers) and what others call it; those of
installed packages are registered (`skd_sim.scenario.road_user`).
"""

from __future__ import annotations

import math
from typing import Final

from skd_sim.errors import UsageError
from skd_sim.scenario.road_user import ROAD_USERS
from skd_sim.scenario.scenario import Scenario

from skd_adversary.crossing.on_foot import PEDESTRIAN as PEDESTRIAN
from skd_adversary.crossing.on_foot import walker
from skd_adversary.crossing.on_wheels import RidingLimits, wheeled
from skd_adversary.crossing.parts import RoadUserModel

_TURN = math.pi / 6.0  # rad, the most that anything on wheels turns in a tick

RUNNER: Final = walker(
    "runner",
    acceleration=3.0,  # m/s², in any direction: to start, to turn and to stop
    fastest=12.0,
    height=1.8,
    called={
        "carla": "walker.pedestrian.0001",
        "openscenario": "pedestrian",
        "osi": "TYPE_PEDESTRIAN",
        "commonroad": "pedestrian",
        "levelxdata": "pedestrian",
    },
)
CHILD: Final = walker(
    "child",
    acceleration=2.0,  # needs some steps to get going
    fastest=8.0,
    height=1.2,
    called={
        "carla": "walker.pedestrian.0011",
        "openscenario": "pedestrian",
        "osi": "TYPE_PEDESTRIAN",
        "commonroad": "pedestrian",
        "levelxdata": "pedestrian",
    },
)
CYCLIST: Final = wheeled(
    "cyclist",
    RidingLimits(acceleration=1.0, deceleration=3.0, lateral=3.0, turn=_TURN, radius=0.0),  # unhurried; a lean of 17°
    fastest=20.0,
    height=1.8,
    called={
        "carla": "vehicle.diamondback.century",
        "metadrive": "CYCLIST",
        "openscenario": "bicycle",
        "osi": "TYPE_BICYCLE",
        "commonroad": "bicycle",
        "levelxdata": "bicycle",
    },
)
E_SCOOTER: Final = wheeled(
    "e_scooter",
    RidingLimits(acceleration=1.2, deceleration=3.5, lateral=2.5, turn=_TURN, radius=0.0),  # a lean of 14°
    fastest=15.0,
    height=1.9,
    called={"openscenario": "bicycle", "osi": "TYPE_STANDUP_SCOOTER", "commonroad": "bicycle"},
)
MOTORCYCLE: Final = wheeled(
    "motorcycle",
    RidingLimits(acceleration=4.0, deceleration=5.5, lateral=4.0, turn=_TURN, radius=2.5),  # a lean of 22°
    fastest=85.0,
    height=1.5,
    called={
        "carla": "vehicle.kawasaki.ninja",
        "metadrive": "CYCLIST",
        "openscenario": "motorbike",
        "osi": "TYPE_MOTORBIKE",
        "commonroad": "motorcycle",
        "levelxdata": "motorcycle",
    },
)
CAR: Final = wheeled(
    "car",
    RidingLimits(acceleration=2.5, deceleration=6.0, lateral=4.0, turn=_TURN, radius=5.5),
    fastest=70.0,
    height=1.5,
    called={
        "carla": "vehicle.tesla.model3",
        "metadrive": "VEHICLE",
        "openscenario": "car",
        "osi": "TYPE_MEDIUM_CAR",
        "commonroad": "car",
        "levelxdata": "car",
    },
)
VAN: Final = wheeled(
    "van",
    RidingLimits(acceleration=2.0, deceleration=5.0, lateral=3.5, turn=_TURN, radius=6.5),
    fastest=50.0,
    height=2.4,
    called={
        "carla": "vehicle.mercedes.sprinter",
        "openscenario": "van",
        "osi": "TYPE_DELIVERY_VAN",
        "levelxdata": "van",
    },
)


def road_user_named(kind: str) -> RoadUserModel:
    """Return the road user of a kind.

    Raises:
        UsageError: there is none, or it is none.
    """
    try:
        found = ROAD_USERS.find(kind)
    except UsageError as error:
        raise UsageError(f"adversary.kind: {error}") from None
    if not isinstance(found, RoadUserModel):
        raise UsageError(f"adversary.kind: road user {kind!r} must be a RoadUserModel, got {type(found).__name__}")
    return found


def check_kind(scenario: Scenario) -> None:
    """Refuse an adversary that is faster than its kind, or has not the shape that it moves with.

    Raises:
        UsageError: it is so, or there is no such kind.
    """
    adversary = scenario.adversary
    user = road_user_named(adversary.kind)
    if adversary.speed > user.fastest:
        raise UsageError(
            f"scenario {scenario.name}: adversary.speed {adversary.speed:g} m/s is more than any {user.name} does; "
            f"give at most {user.fastest:g}"
        )
    if user.kernels.box and not adversary.is_box:
        raise UsageError(
            f"scenario {scenario.name}: a {user.name} is a box that points the way it moves; give adversary.length and "
            "width in place of radius"
        )
