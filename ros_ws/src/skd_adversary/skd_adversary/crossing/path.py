"""φ as the objectives see it: its own pace, how far from it a point is, couplings of a growing trajectory ψ with it.

The discrete Fréchet distance, one point of ψ at a time: Eiter and Mannila (TR CD-TR 94/64, 1994) fill a table c[i, j]
row by row; a row is all that the next one needs. Carried in the state of a POMDP, the row makes the bottleneck of the
whole trajectory a function of state and next point, so that the return of an episode can be the Fréchet distance
itself. Values are squared distances, m².
"""

from __future__ import annotations

import math

import numpy as np
from skd_sim.kernels.compilation import kernel
from skd_sim.world.state import FloatArray


@kernel(inline=True)
def path_velocity(path: FloatArray, tick: int, time_step: float) -> tuple[float, float]:
    """Return φ's own velocity (East, North), m/s, from a tick to the next: that of the action *as φ* of who can.

    Args:
        path: φ, n × 2, m.
        tick: ≥ 0; from n − 1 on φ stands still.
        time_step: s.
    """
    if tick + 1 >= path.shape[0]:
        return 0.0, 0.0
    return (path[tick + 1, 0] - path[tick, 0]) / time_step, (path[tick + 1, 1] - path[tick, 1]) / time_step


@kernel(inline=True)
def pace_at(pace: FloatArray, tick: int) -> tuple[float, float]:
    """Return `path_velocity` of a tick, looked up: `pace` is `path_velocities` of φ's ticks, m/s."""
    if tick >= pace.shape[0]:
        return 0.0, 0.0
    return pace[tick, 0], pace[tick, 1]


def path_velocities(path: FloatArray, ticks: int, time_step: float) -> FloatArray:
    """Return `path_velocity` of ticks 0 … ticks − 1, ticks × 2, m/s."""
    found = np.zeros((ticks, 2))
    own = min(ticks, len(path) - 1)
    found[:own] = (path[1 : own + 1] - path[:own]) / time_step
    return found


def polyline_segments(path: FloatArray) -> FloatArray:
    """Return the segments of a polyline as rows (x, y, Δx, Δy, 1/length²); 0 for the last where the length is.

    Args:
        path: n × 2, m; with one point, its only segment begins and ends there.
    """
    begin, end = (path[:-1], path[1:]) if len(path) > 1 else (path, path)
    along = end - begin
    squared = (along**2).sum(axis=1)
    inverse = np.divide(1.0, squared, out=np.zeros_like(squared), where=squared > 0.0)
    return np.column_stack([begin, along, inverse])


@kernel(inline=True)
def polyline_distance(x: float, y: float, segments: FloatArray) -> float:
    """Return the distance (m) from (x, y) to the polyline whose `polyline_segments` are given."""
    best = math.inf
    for i in range(segments.shape[0]):
        along_x, along_y = segments[i, 2], segments[i, 3]
        px, py = x - segments[i, 0], y - segments[i, 1]
        s = min(1.0, max(0.0, (px * along_x + py * along_y) * segments[i, 4]))
        dx, dy = px - s * along_x, py - s * along_y
        best = min(best, dx * dx + dy * dy)
    return math.sqrt(best)


@kernel(inline=True)
def first_row(x: float, y: float, path: FloatArray, rows: FloatArray, begin: int) -> None:
    """Write the row of ψ = ((x, y)): entry j is the squared distance of ψ to the first j + 1 points of φ.

    Args:
        x: place of the new point of ψ to the East, m.
        y: place of the new point of ψ to the North, m.
        path: φ, n × 2, m.
        rows: array whose entries begin … begin + n − 1 are the row, m²; written.
        begin: index at which the row begins. (A slice would cost more than the row.)
    """
    worst = 0.0
    for j in range(path.shape[0]):
        dx, dy = x - path[j, 0], y - path[j, 1]
        worst = max(worst, dx * dx + dy * dy)
        rows[begin + j] = worst


@kernel(inline=True)
def next_row(x: float, y: float, path: FloatArray, rows: FloatArray, after: FloatArray, begin: int) -> float:
    """Write the row of ψ extended by (x, y), and return its least value: no continuation can come closer than that.

    Args:
        x: place of the new point of ψ to the East, m.
        y: place of the new point of ψ to the North, m.
        path: φ, n × 2, m.
        rows: holds the row of ψ so far, as in `first_row`; may be `after` itself.
        after: receives the new row at the same place.
        begin: index at which the row begins.
    """
    diagonal = math.inf  # c[i − 1, j − 1]
    beside = math.inf  # c[i, j − 1]
    least = math.inf
    for j in range(path.shape[0]):
        above = rows[begin + j]
        dx, dy = x - path[j, 0], y - path[j, 1]
        link = dx * dx + dy * dy
        reach = above if above < diagonal else diagonal
        reach = beside if beside < reach else reach
        diagonal = above
        beside = link if link > reach else reach
        after[begin + j] = beside
        least = beside if beside < least else least
    return least
