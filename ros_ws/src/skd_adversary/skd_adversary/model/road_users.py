"""The kinds of road user that there are, by name. Each is a module of its own, imported when it is asked for."""

from __future__ import annotations

import importlib
from typing import Final

from skd_sim.errors import UsageError

from skd_adversary.model.parts import RoadUserModel

MODULES: Final = {
    "pedestrian": "skd_adversary.model.road_user.pedestrian",
    "cyclist": "skd_adversary.model.road_user.cyclist",
}
"""Name (`adversary.kind` of a scenario) → module whose `ROAD_USER` it is."""


def road_user_named(kind: str) -> RoadUserModel:
    """Return the road user of a kind.

    Raises:
        UsageError: there is none.
    """
    if kind not in MODULES:
        raise UsageError(f"adversary.kind {kind!r} is no road user that SKD knows; there are {', '.join(MODULES)}")
    found: RoadUserModel = importlib.import_module(MODULES[kind]).ROAD_USER
    return found
