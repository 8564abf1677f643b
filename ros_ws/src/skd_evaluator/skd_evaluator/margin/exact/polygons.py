"""Kernels of convex polygons: cut, sum, hull. What is rounded is rounded outwards: a result never holds too little.

A polygon is an array of points (m) and how many of them count, anticlockwise; a single point and a segment are polygons
as well, and one of 0 points is empty.
"""

from __future__ import annotations

import math

import numpy as np
from skd_sim.kernels.compilation import kernel
from skd_sim.world.state import FloatArray

MOST = 96
"""Room for the points of a polygon."""
SLACK = 1e-9  # m
_CUTS = 64  # of a disc, at most


@kernel
def _copy(points: FloatArray, count: int, out: FloatArray) -> None:
    for i in range(count):
        out[i, 0], out[i, 1] = points[i, 0], points[i, 1]


@kernel
def cut(points: FloatArray, count: int, a: float, b: float, c: float, out: FloatArray) -> int:
    """Write the part of a polygon with a·x + b·y ≤ c; return the number of its points. `out` is not `points`."""
    n = 0
    if count == 0:
        return 0
    if count + 2 > MOST:  # no room for what a cut adds
        _copy(points, count, out)
        return count
    x, y = points[count - 1, 0], points[count - 1, 1]
    before = a * x + b * y - c
    for i in range(count):
        x_to, y_to = points[i, 0], points[i, 1]
        after = a * x_to + b * y_to - c
        if (before > 0.0) != (after > 0.0):
            share = before / (before - after)
            out[n, 0], out[n, 1] = x + share * (x_to - x), y + share * (y_to - y)
            n += 1
        if after <= 0.0:
            out[n, 0], out[n, 1] = x_to, y_to
            n += 1
        x, y, before = x_to, y_to, after
    return n


@kernel
def cut_to_capsule(
    points: FloatArray,
    count: int,
    a: tuple[float, float],
    b: tuple[float, float],
    radius: float,
    relative: float,
    other: FloatArray,
) -> int:
    """Cut a polygon, in place, to what is within a radius of the segment from a to b, or a little more.

    Args:
        points: corners of the polygon; receives those of the result.
        count: how many corners it has.
        a: begin of the segment, m.
        b: its end, m.
        radius: greatest distance from the segment, m.
        relative: by how much the result may be too large, as a share of the radius.
        other: room for another polygon.

    Returns:
        Number of points.
    """
    (ax, ay), (bx, by) = a, b
    dx, dy = bx - ax, by - ay
    squared = dx * dx + dy * dy
    most = radius * (1.0 + relative)
    for _ in range(_CUTS):
        far, ux, uy = most * most, 0.0, 0.0
        found = False
        for i in range(count):
            px, py = points[i, 0] - ax, points[i, 1] - ay
            s = min(1.0, max(0.0, (px * dx + py * dy) / squared)) if squared > 0.0 else 0.0
            ex, ey = px - s * dx, py - s * dy
            away = ex * ex + ey * ey
            if away > far:
                far, ux, uy, found = away, ex, ey, True
        if not found or count + 2 >= MOST:
            break
        length = math.sqrt(far)
        ux, uy = ux / length, uy / length
        bound = max(ux * ax + uy * ay, ux * bx + uy * by) + radius + SLACK
        n = cut(points, count, ux, uy, bound, other)
        _copy(other, n, points)
        count = n
        if count == 0:
            break
    return count


@kernel
def _lowest(points: FloatArray, count: int) -> int:
    best = 0
    for i in range(1, count):
        if points[i, 1] < points[best, 1] or (points[i, 1] == points[best, 1] and points[i, 0] < points[best, 0]):
            best = i
    return best


@kernel
def add(points: FloatArray, count: int, others: FloatArray, other_count: int, out: FloatArray) -> int:
    """Write the Minkowski sum of two polygons that are not empty; return the number of its points."""
    first, second = _lowest(points, count), _lowest(others, other_count)
    i = j = n = 0
    last_x = last_y = 0.0
    while i < count or j < other_count:
        p, q = points[(first + i) % count], others[(second + j) % other_count]
        p_to, q_to = points[(first + i + 1) % count], others[(second + j + 1) % other_count]
        x, y = p[0] + q[0], p[1] + q[1]
        if n == 0 or max(abs(x - last_x), abs(y - last_y)) > 1e-12:
            if n == MOST:
                return _box(points, count, others, other_count, out)
            out[n, 0], out[n, 1] = x, y
            n += 1
            last_x, last_y = x, y
        if j == other_count:
            i += 1
        elif i == count:
            j += 1
        else:
            turn = (p_to[0] - p[0]) * (q_to[1] - q[1]) - (p_to[1] - p[1]) * (q_to[0] - q[0])
            if turn >= 0.0:
                i += 1
            if turn <= 0.0:
                j += 1
    return n


@kernel
def _box(points: FloatArray, count: int, others: FloatArray, other_count: int, out: FloatArray) -> int:
    """Write the box around a Minkowski sum."""
    x_low, x_high = np.min(points[:count, 0]), np.max(points[:count, 0])
    y_low, y_high = np.min(points[:count, 1]), np.max(points[:count, 1])
    x_low, x_high = x_low + np.min(others[:other_count, 0]), x_high + np.max(others[:other_count, 0])
    y_low, y_high = y_low + np.min(others[:other_count, 1]), y_high + np.max(others[:other_count, 1])
    out[0, 0], out[0, 1] = x_low, y_low
    out[1, 0], out[1, 1] = x_high, y_low
    out[2, 0], out[2, 1] = x_high, y_high
    out[3, 0], out[3, 1] = x_low, y_high
    return 4


@kernel
def hull(points: FloatArray, count: int, out: FloatArray) -> int:
    """Write the convex hull of points, whose order is changed; return the number of its points."""
    for i in range(1, count):  # by x, then y
        x, y = points[i, 0], points[i, 1]
        j = i - 1
        while j >= 0 and (points[j, 0] > x or (points[j, 0] == x and points[j, 1] > y)):
            points[j + 1, 0], points[j + 1, 1] = points[j, 0], points[j, 1]
            j -= 1
        points[j + 1, 0], points[j + 1, 1] = x, y
    n = 0
    if count == 1:
        out[0, 0], out[0, 1] = points[0, 0], points[0, 1]
        return 1
    for half in range(2):
        begin = n
        for step in range(count):
            i = step if half == 0 else count - 1 - step
            x, y = points[i, 0], points[i, 1]
            while n >= begin + 2 or (n >= begin + 1 and out[n - 1, 0] == x and out[n - 1, 1] == y):
                if n >= begin + 2:
                    ax, ay = out[n - 1, 0] - out[n - 2, 0], out[n - 1, 1] - out[n - 2, 1]
                    if ax * (y - out[n - 2, 1]) - ay * (x - out[n - 2, 0]) > 0.0:
                        break
                n -= 1
            if n == MOST:  # no room: the box around them all
                return _box(points, count, np.zeros((1, 2)), 1, out)
            out[n, 0], out[n, 1] = x, y
            n += 1
        if n > begin + 1 or (half == 0 and n > 1):
            n -= 1  # the last is the first of the other half
    return n


@kernel
def half_planes(points: FloatArray, count: int, out: FloatArray) -> int:
    """Write rows (a, b, c) so that a point (x, y) of the polygon has a·x + b·y ≤ c for all of them; return how many.

    Of what is no wider than a line it is the box around it.
    """
    n = 0
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        dx, dy = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
        length = math.sqrt(dx * dx + dy * dy)
        if length > 1e-7:
            out[n, 0], out[n, 1] = dy / length, -dx / length
            n += 1
    if n < 3:
        n = 4
        for i in range(n):
            out[i, 0], out[i, 1] = (1.0, -1.0, 0.0, 0.0)[i], (0.0, 0.0, 1.0, -1.0)[i]
    for i in range(n):
        out[i, 2] = -np.inf
        for k in range(count):
            out[i, 2] = max(out[i, 2], out[i, 0] * points[k, 0] + out[i, 1] * points[k, 1] + SLACK)
    return n
