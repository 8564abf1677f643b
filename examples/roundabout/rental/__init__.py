"""What this package adds to SKD: a rental e-scooter, and the exit of a roundabout where one crosses."""

from __future__ import annotations

import math
from pathlib import Path

EXIT = Path(__file__).with_name("roundabout_exit.yaml")


def __getattr__(name: str) -> object:
    """Make the scooter when it is asked for: who wants the scenario alone waits for no kernels."""
    if name != "SCOOTER":
        raise AttributeError(name)
    from skd_adversary.crossing.road_users import RidingLimits, wheeled

    limits = RidingLimits(
        acceleration=0.8,  # m/s²: its motor is throttled
        deceleration=3.5,  # m/s²: what the law asks of its brakes
        lateral=2.0,  # m/s²: a lean of 12°
        turn=math.pi / 6.0,  # rad in a tick
        radius=1.0,  # m, of the tightest circle
    )
    return wheeled("rental_scooter", limits, fastest=20.0 / 3.6, height=1.9)
