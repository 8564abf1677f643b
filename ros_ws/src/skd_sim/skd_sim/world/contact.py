"""Contact between the car's oriented rectangle and the adversary's disc or box, swept over a time step.

Within a step both move uniformly and keep their headings. Seen from the car the other's centre then runs along a
straight segment. The first contact with a disc is the first point of that segment whose distance to the rectangle is
the disc's radius; two boxes touch as long as no edge's direction separates them, which is an interval of time for each
of the four. Nothing can tunnel, however long the step. A car that turns is looked at in parts of the step.
"""

from __future__ import annotations

import math

from skd_sim.kernels.compilation import kernel
from skd_sim.world.state import FloatArray, Pair, Triple

NO_CONTACT = math.inf


@kernel
def to_car_frame(x: float, y: float, car_x: float, car_y: float, heading: float) -> Pair:
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
def slab(start: float, delta: float, low: float, high: float) -> Pair:
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
    a_in, a_out = slab(a0, da, a_lo, a_hi)
    l_in, l_out = slab(l0, dl, -l_hi, l_hi)
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
def first_contact(before: Pair, after: Pair, footprint: Triple, radius: float) -> float:
    """Return the fraction in [0, 1] of the step at which the disc first touches the rectangle, else infinity.

    The rectangle grown by the disc is two boxes and four corner discs; the earliest entry into any is the contact.

    Args:
        before: how far the disc's centre is ahead of the car's reference point, and to the left of its axis, when the
            step begins, m.
        after: the same when the step ends, m.
        footprint: footprint of the car: front, rear and half width, m.
        radius: radius of the disc, m.
    """
    ahead, left = before
    front, rear, half_width = footprint
    da, dl = after[0] - ahead, after[1] - left
    first = min(
        _enter_box(ahead, left, da, dl, -rear - radius, front + radius, half_width),
        _enter_box(ahead, left, da, dl, -rear, front, half_width + radius),
    )
    for corner_ahead in (front, -rear):
        for corner_left in (half_width, -half_width):
            first = min(first, _enter_disc(ahead, left, da, dl, corner_ahead, corner_left, radius))
    return first


@kernel
def first_contact_of_boxes(before: Pair, after: Pair, turned: float, footprint: Triple, other: Pair) -> float:
    """Return the fraction in [0, 1] of the step at which another box first touches the rectangle, else infinity.

    By separating axes: two rectangles touch where their shadows on all four edges' directions overlap, and in uniform
    motion each two shadows overlap for one interval of time.

    Args:
        before: how far the other box's centre is ahead of the car's reference point, and to the left of its axis, when
            the step begins, m.
        after: the same when the step ends, m.
        turned: heading of the other box from the car's, rad.
        footprint: footprint of the car: front, rear and half width, m.
        other: half length and half width of the other box, m.
    """
    ahead, left = before
    front, rear, half_width = footprint
    other_half_length, other_half_width = other
    da, dl = after[0] - ahead, after[1] - left
    cos, sin = math.cos(turned), math.sin(turned)
    half_length, middle = 0.5 * (front + rear), 0.5 * (front - rear)
    a, reach_a = ahead - middle, abs(cos) * other_half_length + abs(sin) * other_half_width
    reach_l = abs(sin) * other_half_length + abs(cos) * other_half_width
    own_length = abs(cos) * half_length + abs(sin) * half_width + other_half_length
    own_width = abs(sin) * half_length + abs(cos) * half_width + other_half_width
    enter, leave = 0.0, 1.0
    for start, delta, apart in (
        (a, da, half_length + reach_a),
        (left, dl, half_width + reach_l),
        (cos * a + sin * left, cos * da + sin * dl, own_length),
        (cos * left - sin * a, cos * dl - sin * da, own_width),
    ):
        first, last = slab(start, delta, -apart, apart)
        enter, leave = max(enter, first), min(leave, last)
    return enter if enter <= leave else math.inf


@kernel
def first_touch(before: Pair, after: Pair, turned: float, footprint: Triple, shape: Triple) -> float:
    """Return `first_contact` or `first_contact_of_boxes`, of a shape as `sweep` takes it."""
    if shape[0] > 0.0:
        return first_contact(before, after, footprint, shape[0])
    return first_contact_of_boxes(before, after, turned, footprint, (shape[1], shape[2]))


@kernel
def sweep(
    path: FloatArray,
    place: Pair,
    end: Pair,
    velocity: Pair,
    heading: float,
    footprint: Triple,
    shape: Triple,
    time_step: float,
    period: int,
    periods: int,
) -> Pair:
    """Move the adversary uniformly beside the car's path in one control period of a step.

    Args:
        path: path of the car, n × 4: x, y (m), heading (rad) and speed (m/s) at uniform times over the period.
        place: place of the adversary when the step begins, (x, y), m.
        end: place of the adversary when the step ends, (x, y), m.
        velocity: velocity of the adversary, (East, North), m/s.
        heading: heading of the adversary's box, rad; not used for a disc.
        footprint: footprint of the car: front, rear and half width, m.
        shape: shape of the adversary: radius, half length and half width, m; a disc has a radius, a box has none.
        time_step: duration of a step, s.
        period: number of the period in the step.
        periods: number of control periods in a step.

    Returns:
        Fraction of the step at the first contact or infinity, and the car's speed there, m/s.
    """
    parts = path.shape[0] - 1
    whole = periods * parts
    x, y = place
    if period > 0:
        passed = time_step * (period * parts) / whole
        x, y = place[0] + passed * velocity[0], place[1] + passed * velocity[1]
    for part in range(parts):
        index = period * parts + part + 1
        last = index == whole
        passed = time_step * index / whole
        x_after = end[0] if last else place[0] + passed * velocity[0]
        y_after = end[1] if last else place[1] + passed * velocity[1]
        before, after = path[part], path[part + 1]
        seen = to_car_frame(x, y, before[0], before[1], before[2])
        seen_after = to_car_frame(x_after, y_after, after[0], after[1], after[2])
        contact = first_touch(seen, seen_after, heading - before[2], footprint, shape)
        if contact <= 1.0:
            return (index - 1 + contact) / whole, before[3] + contact * (after[3] - before[3])
        x, y = x_after, y_after
    return NO_CONTACT, 0.0


@kernel
def runs_into(rectangles: FloatArray, x: float, y: float, x_after: float, y_after: float, radius: float) -> bool:
    """Return whether a disc that moves from one point (m) straight to another touches one of the rectangles.

    Args:
        rectangles: n × 5: centre (m), heading (rad), half length, half width (m).
        x: x of the disc's centre when the step begins, m.
        y: y of the disc's centre when the step begins, m.
        x_after: x of the disc's centre when the step ends, m.
        y_after: y of the disc's centre when the step ends, m.
        radius: radius of the disc, m.
    """
    for row in rectangles:
        seen = to_car_frame(x, y, row[0], row[1], row[2])
        seen_after = to_car_frame(x_after, y_after, row[0], row[1], row[2])
        if first_contact(seen, seen_after, (row[3], row[3], row[4]), radius) <= 1.0:
            return True
    return False


@kernel
def clearance(rectangles: FloatArray, x: float, y: float) -> float:
    """Return the distance (m) from a point (m) to the nearest of the rectangles (n × 5); infinity without any."""
    nearest = float("inf")
    for row in rectangles:
        ahead, left = to_car_frame(x, y, row[0], row[1], row[2])
        nearest = min(nearest, rectangle_distance(ahead, left, row[3], row[3], row[4]))
    return nearest
