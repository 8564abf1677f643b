"""Looking again and again at figures that grow: intervals that hold together at every look.

Who goes on until an interval is narrow enough, and looks each time, stops where chance made it narrow: a 95 % interval
then holds less often than it says. Repeated confidence intervals (Jennison and Turnbull, Journal of the Royal
Statistical Society B 51, 1989) hold at all looks together with the confidence stated, and so at whichever one stops.
Each is an ordinary interval of a higher, nominal confidence: the one that Pocock's test (Biometrika 64, 1977) has for
so many looks at equal distances. With Student's t in the place of the normal distribution that is the significance
level approach of Jennison and Turnbull (Group Sequential Methods, 2000, section 11.5).
"""

from __future__ import annotations

import functools
import math

import numpy as np
from scipy import special

from skd_evaluator.measure.statistics import FloatArray, checked_confidence

_NODES = 120
_STEPS = 60  # of the bisection: far below rounding


@functools.cache
def nominal_confidence(looks: int, confidence: float = 0.95) -> float:
    """Return the confidence of each of several looks that gives all of them together the one stated.

    Args:
        looks: how many there are at most, after equal amounts of data, ≥ 1.
        confidence: of all together, in (0, 1).

    Raises:
        ValueError: no look, or a confidence outside (0, 1).
    """
    checked_confidence(confidence)
    if looks < 1:
        raise ValueError(f"there must be at least one look, got {looks}")
    low, high = 0.0, 10.0
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _held(middle, looks) < confidence else (low, middle)
    return float(special.ndtr(high) - special.ndtr(-high))


def _held(bound: float, looks: int) -> float:
    """Return how likely sums of standard normal numbers stay within ± bound·√k after each k of `looks`.

    By the recursion of Armitage, McPherson and Rowe (1969), integrated with Gauss and Legendre's rule.
    """
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    places, shares = bound * nodes, bound * weights
    density = _normal(places)
    for look in range(2, looks + 1):
        reach = bound * math.sqrt(look)
        further = reach * nodes
        density = _normal(further[:, None] - places[None, :]) @ (shares * density)
        places, shares = further, reach * weights
    return float(shares @ density)


def _normal(places: FloatArray) -> FloatArray:
    return np.exp(-0.5 * places**2) / math.sqrt(2.0 * math.pi)
