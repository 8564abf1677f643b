"""States of the two road users: world frame `map` (ENU: x East, y North), metres, m/s, rad."""

from __future__ import annotations

from typing import NamedTuple


class CarState(NamedTuple):
    """Car: position of its reference point (m), heading (rad, counter-clockwise from East), speed (m/s)."""

    x: float
    y: float
    heading: float
    speed: float


class AdversaryState(NamedTuple):
    """Adversary: position of the centre (m), velocity over the last time step (m/s), heading of a box (rad).

    A disc points nowhere: its heading is 0.
    """

    x: float
    y: float
    vx: float
    vy: float
    heading: float = 0.0
