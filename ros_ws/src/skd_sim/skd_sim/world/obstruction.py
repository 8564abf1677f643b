"""Parked rectangles in the adversary's way: whether a step leads into one of them."""

from __future__ import annotations

from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel
from skd_sim.world.contact import first_contact, rectangle_distance, to_car_frame


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
        ahead, left = to_car_frame(x, y, row[0], row[1], row[2])
        ahead_after, left_after = to_car_frame(x_after, y_after, row[0], row[1], row[2])
        if first_contact(ahead, left, ahead_after, left_after, row[3], row[3], row[4], radius) <= 1.0:
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
