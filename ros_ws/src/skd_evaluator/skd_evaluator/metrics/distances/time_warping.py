"""Dynamic time warping: how far ψ is from φ on average, where each may wait for the other.

The time-normalised distance of Sakoe and Chiba ("Dynamic programming algorithm optimization for spoken word
recognition", IEEE Transactions on Acoustics, Speech, and Signal Processing 26, 1978), symmetric form without a slope
constraint: the least sum of d(φ_i, ψ_j) over couplings that step by one in i, in j or in both, where a step in both
counts twice, over the number of points of φ and ψ together. φ is cut at the duration of ψ, as for the prefix distance.
Unlike the discrete Fréchet distance it is a mean and no maximum: one wide turn weighs little in it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel
from skd_sim.world.state import Trajectory

from skd_evaluator.metrics.distances.measures import Measure, Pair
from skd_evaluator.metrics.statistics.prior import PREFIXES


@kernel(allocates=True)
def _least_sum(phi: FloatArray, psi: FloatArray) -> float:
    row = np.full(len(psi), np.inf)
    for i in range(len(phi)):
        diagonal = np.inf  # entry (i − 1, j − 1)
        for j in range(len(psi)):
            distance = 0.0
            for axis in range(phi.shape[1]):
                difference = phi[i, axis] - psi[j, axis]
                distance += difference * difference
            distance = math.sqrt(distance)
            above = row[j]
            if i == 0 and j == 0:
                row[j] = 2.0 * distance
            else:
                least = min(above + distance, diagonal + 2.0 * distance)
                row[j] = min(least, row[j - 1] + distance) if j > 0 else least
            diagonal = above
    return float(row[-1])


def warped_distance(phi: FloatArray, psi: FloatArray) -> float:
    """Return the time-normalised distance of two curves.

    Args:
        phi: n × d positions, m; n ≥ 1.
        psi: m × d positions, m; m ≥ 1.

    Returns:
        The distance, m.
    """
    return float(_least_sum(phi, psi)) / (len(phi) + len(psi))


def _of_pairs(phi: Trajectory, pairs: Sequence[Pair]) -> list[float]:
    return [warped_distance(phi.prefix(min(len(one.psi), len(phi))).positions, one.psi.positions) for one in pairs]


WARPED = Measure("time-warped distance to φ", "m", _of_pairs, shown=False, prior=PREFIXES)
