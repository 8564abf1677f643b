"""States of the two road users: world frame `map` (ENU: x East, y North), metres, m/s, rad."""

from __future__ import annotations

from typing import NamedTuple


class CarState(NamedTuple):
    """Car: position of its reference point (m), heading (rad, counter-clockwise from East), speed (m/s)."""

    x: float
    y: float
    heading: float
    speed: float


class PedestrianState(NamedTuple):
    """Pedestrian: position of the centre (m) and velocity over the last time step (m/s)."""

    x: float
    y: float
    vx: float
    vy: float
