"""States of who is on the road: world frame `map` (ENU: x East, y North), metres, m/s, rad."""

from __future__ import annotations

from typing import NamedTuple


class CarState(NamedTuple):
    """Car: position of its reference point (m), heading (rad, counter-clockwise from East), speed (m/s)."""

    x: float
    y: float
    heading: float
    speed: float


class RoadUserState(NamedTuple):
    """Anybody but the car: position of the centre (m), velocity over the last time step (m/s), heading of a box (rad).

    A disc points nowhere: its heading is 0.
    """

    x: float
    y: float
    vx: float
    vy: float
    heading: float = 0.0

    def moved(self, after: RoadUserState, passed: float) -> RoadUserState:
        """Return the state after a time (s) of the time step that ends in another state."""
        return RoadUserState(self.x + passed * after.vx, self.y + passed * after.vy, *after[2:])


AdversaryState = RoadUserState
"""What a road user's state is called where it is the adversary's."""


class Scene(NamedTuple):
    """Everybody at a moment: the car under test, the adversary, and the others of the scenario in its order."""

    ego: CarState
    adversary: RoadUserState
    others: tuple[RoadUserState, ...] = ()
