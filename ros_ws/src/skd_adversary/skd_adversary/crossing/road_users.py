"""The kinds of road user that the adversary can be, by name: SKD's own, and those of installed packages."""

from __future__ import annotations

from skd_sim.errors import UsageError
from skd_sim.scenario.road_user import ROAD_USERS
from skd_sim.scenario.scenario import Scenario

from skd_adversary.crossing.parts import RoadUserModel


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
