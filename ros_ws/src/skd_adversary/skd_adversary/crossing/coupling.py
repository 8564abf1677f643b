"""Couplings of a growing trajectory ψ with a fixed one φ: the discrete Fréchet distance, one point of ψ at a time.

Eiter and Mannila (TR CD-TR 94/64, 1994) fill a table c[i, j] row by row; a row is all that the next one needs. Carried
in the state of a POMDP, the row makes the bottleneck of the whole trajectory a function of state and next point, so
that the return of an episode can be the Fréchet distance itself. Values are squared distances, m².
"""

from __future__ import annotations

import math

from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel


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
