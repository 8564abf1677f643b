"""The kinds of road user, by name; what is special to a kind stands in a module of its own, above this package."""

from __future__ import annotations

from typing import Final

from skd_sim.options.registry import Registry
from skd_sim.scenario.road_user import HEIGHT, Body

_OWN = ("pedestrian", "runner", "child", "cyclist", "e_scooter", "motorcycle", "car", "van")
ROAD_USERS: Final = Registry(
    "road user", "skd.road_users", {kind: f"skd_adversary.crossing.road_user.{kind}:ROAD_USER" for kind in _OWN}
)
"""Of the key `adversary.kind` of a scenario. Others of a scenario may be of these kinds, or of any that has a name."""

CAR: Final = "car"
"""The kind of the car under test."""


def height_of(kind: str) -> float:
    """Return how high a road user of a kind is drawn, m."""
    return float(ROAD_USERS.find(kind).height) if kind in ROAD_USERS else HEIGHT


def called(body: Body, where: str) -> str:
    """Return what another simulator, or a format, calls a road user of a body's kind.

    A kind that has no word for it there is called as the kind car is if its body is a box, else as a pedestrian is.
    """
    word = ROAD_USERS.find(body.kind).called.get(where) if body.kind in ROAD_USERS else None
    return str(word or ROAD_USERS.find(CAR if body.is_box else "pedestrian").called[where])
