"""Contact between the car's oriented rectangle and the pedestrian's disc, swept over a time step.

Within a step both move uniformly and the car keeps its heading. Seen from the car the disc's centre then
runs along a straight segment, and the first contact is the first point of that segment whose distance to the
rectangle is the disc's radius: nothing can tunnel, however long the step.
"""

from __future__ import annotations

import math

from skd_sim.compilation import kernel

NO_CONTACT = math.inf


@kernel
def to_car_frame(x: float, y: float, car_x: float, car_y: float, heading: float) -> tuple[float, float]:
    """Return a world point (m) in the car's frame: (ahead of, left of) its reference point."""
    cos, sin = math.cos(heading), math.sin(heading)
    dx, dy = x - car_x, y - car_y
    return cos * dx + sin * dy, cos * dy - sin * dx


@kernel
def rectangle_distance(ahead: float, left: float, front: float, rear: float, half_width: float) -> float:
    """Return the distance (m) from a point in the car's frame to the footprint; 0 inside.

    Args:
        ahead: longitudinal coordinate, m.
        left: lateral coordinate, m.
        front: footprint ahead of the reference point, m.
        rear: footprint behind the reference point, m.
        half_width: footprint to each side, m.
    """
    outside_ahead = max(0.0, ahead - front, -rear - ahead)
    outside_left = max(0.0, abs(left) - half_width)
    return math.sqrt(outside_ahead * outside_ahead + outside_left * outside_left)


@kernel
def _slab(start: float, delta: float, low: float, high: float) -> tuple[float, float]:
    """Return the interval of s for which low ≤ start + s·delta ≤ high (empty: first > second)."""
    if delta == 0.0:
        if low <= start <= high:
            return -math.inf, math.inf
        return math.inf, -math.inf
    first, second = (low - start) / delta, (high - start) / delta
    return (first, second) if first <= second else (second, first)


@kernel
def _enter_box(a0: float, l0: float, da: float, dl: float, a_lo: float, a_hi: float, l_hi: float) -> float:
    """Return the first s in [0, 1] at which the segment is in the box, else infinity."""
    a_in, a_out = _slab(a0, da, a_lo, a_hi)
    l_in, l_out = _slab(l0, dl, -l_hi, l_hi)
    enter, leave = max(a_in, l_in, 0.0), min(a_out, l_out, 1.0)
    return enter if enter <= leave else math.inf


@kernel
def _enter_disc(a0: float, l0: float, da: float, dl: float, ca: float, cl: float, radius: float) -> float:
    """Return the first s in [0, 1] at which the segment is within `radius` of (ca, cl), else infinity."""
    pa, pl = a0 - ca, l0 - cl
    c = pa * pa + pl * pl - radius * radius
    if c <= 0.0:
        return 0.0
    a = da * da + dl * dl
    b = pa * da + pl * dl
    discriminant = b * b - a * c
    if a == 0.0 or b >= 0.0 or discriminant < 0.0:
        return math.inf
    s = (-b - math.sqrt(discriminant)) / a
    return s if s <= 1.0 else math.inf


@kernel
def first_contact(
    ahead: float,
    left: float,
    ahead_after: float,
    left_after: float,
    front: float,
    rear: float,
    half_width: float,
    radius: float,
) -> float:
    """Return the fraction in [0, 1] of the step at which the disc first touches the rectangle, else infinity.

    The rectangle grown by the disc is two boxes and four corner discs; the earliest entry into any is the contact.

    Args:
        ahead: disc centre in the car's frame when the step begins, m.
        left: likewise, lateral, m.
        ahead_after: disc centre in the car's frame when the step ends, m.
        left_after: likewise, lateral, m.
        front: footprint ahead of the reference point, m.
        rear: footprint behind the reference point, m.
        half_width: footprint to each side, m.
        radius: of the disc, m.
    """
    da, dl = ahead_after - ahead, left_after - left
    first = min(
        _enter_box(ahead, left, da, dl, -rear - radius, front + radius, half_width),
        _enter_box(ahead, left, da, dl, -rear, front, half_width + radius),
    )
    for corner_ahead in (front, -rear):
        for corner_left in (half_width, -half_width):
            first = min(first, _enter_disc(ahead, left, da, dl, corner_ahead, corner_left, radius))
    return first
