"""With which side of the car somebody was touched, and how near somebody came to its front while it moved."""

from __future__ import annotations

import math
from typing import Final

from skd_sim.arrays import FloatArray
from skd_sim.geometry.contact import to_car_frame
from skd_sim.kernels.compilation import kernel

SAME: Final = 1e-6
"""m by which a touching disc's distance may differ from its radius."""
_PARTS: Final = 4  # of a tick, at whose ends the clearance is looked at


@kernel
def in_car_frame(
    path: FloatArray, here: tuple[float, float], there: tuple[float, float], share: float
) -> tuple[float, float, float]:
    """Return where somebody is in the car's frame at a share of the tick, and the car's speed there."""
    before, after = path[0], path[1]
    x, y = here[0] + share * (there[0] - here[0]), here[1] + share * (there[1] - here[1])
    car_x, car_y = before[0] + share * (after[0] - before[0]), before[1] + share * (after[1] - before[1])
    ahead, left = to_car_frame(x, y, car_x, car_y, before[2] + share * (after[2] - before[2]))
    return ahead, left, before[3] + share * (after[3] - before[3])


@kernel
def side_touched(
    path: FloatArray,
    here: tuple[float, float],
    there: tuple[float, float],
    share: float,
    footprint: tuple[float, float, float],
    radius: float,
    impact: float,
    hit_speed: float,
) -> int:
    """Return how a touch counts, a `Touch`.

    A disc that touches a side has its centre a radius beside it; one whose centre is nearer to the axis touches front
    or rear, or one of their corners.

    Args:
        path: of the car in the tick, its two ends, 2 × 4.
        here: where somebody is when the tick begins, m.
        there: and when it ends, m.
        share: of the tick at the contact.
        footprint: of the car: front, rear and half width, m.
        radius: of the disc, m.
        impact: speed of the car at the contact, m/s.
        hit_speed: of a hit, at the least, m/s.
    """
    if impact < hit_speed:
        return 3
    ahead, left, _ = in_car_frame(path, here, there, share)
    front, rear, half_width = footprint
    if abs(left) >= half_width + radius - SAME or ahead <= 0.5 * (front - rear):
        return 2
    return 1


@kernel
def clearance_of(
    path: FloatArray,
    here: tuple[float, float],
    there: tuple[float, float],
    until: float,
    footprint: tuple[float, float, float],
    radius: float,
    hit_speed: float,
) -> float:
    """Return the least distance of a disc to the front of the car in a tick, while the car moves, m; else infinity.

    It orders crossings by how near they are to a hit, and no more hangs on it: it is looked at some times in a tick.

    Args:
        path: of the car in the tick, its two ends, 2 × 4.
        here: where somebody is when the tick begins, m.
        there: and when it ends, m.
        until: share of the tick up to which to look.
        footprint: of the car: front, rear and half width, m.
        radius: of the disc, m.
        hit_speed: speed of the car from which on it moves, m/s.
    """
    least = math.inf
    for part in range(_PARTS + 1):
        ahead, left, speed = in_car_frame(path, here, there, until * part / _PARTS)
        if speed >= hit_speed:
            aside = max(0.0, abs(left) - footprint[2])
            off = ahead - footprint[0]
            least = min(least, max(0.0, math.sqrt(off * off + aside * aside) - radius))
    return least
