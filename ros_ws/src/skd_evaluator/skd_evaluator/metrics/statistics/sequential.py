"""Looking again and again at figures that grow: intervals that hold together at every look.

If one goes on until an interval is narrow enough, and looks each time, one stops where chance made it narrow: a 95 %
interval then holds less often than it says. Repeated confidence intervals (Jennison and Turnbull, Journal of the Royal
Statistical Society B 51, 1989) hold at all looks together with the confidence stated, and so at whichever one stops.
Each is an ordinary interval of a higher, nominal confidence: the one that Pocock's test (Biometrika 64, 1977) has for
so many looks at equal distances. With Student's t in the place of the normal distribution that is the significance
level approach of Jennison and Turnbull (Group Sequential Methods, 2000, section 11.5).
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from skd_sim.arrays import FloatArray

from skd_evaluator.metrics.statistics.clustered import Clustered
from skd_evaluator.metrics.statistics.statistics import checked_confidence

MOST_LOOKS = 100
"""Looks for which the integral is right to ten digits. Its nodes are spread over ± bound·√looks, and from some 150 on
they lie so far apart that the confidence falls again: with 1,000 looks it would be less than that of one."""
_NODES = 100
_STEPS = 48  # of the bisection: to 1e-13


@functools.cache
def nominal_confidence(looks: int, confidence: float = 0.95) -> float:
    """Return the confidence that each of several looks needs for all of them together to have the one stated.

    Args:
        looks: greatest number of looks, after equal amounts of data, from 1 to `MOST_LOOKS`.
        confidence: confidence of all looks together, in (0, 1).

    Raises:
        ValueError: no look, or more than `MOST_LOOKS`, or a confidence outside (0, 1).
    """
    checked_confidence(confidence)
    if not 1 <= looks <= MOST_LOOKS:
        raise ValueError(f"there must be at least one look, and at most {MOST_LOOKS}, got {looks}")
    low, high = 0.0, 10.0
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _held(middle, looks) < confidence else (low, middle)
    return float(scipy.special.ndtr(high) - scipy.special.ndtr(-high))


def _held(bound: float, looks: int) -> float:
    """Return how likely sums of standard normal numbers stay within ± bound·√k after each k of `looks`.

    By the recursion of Armitage, McPherson and Rowe (1969), integrated with Gauss and Legendre's rule.
    """
    nodes, weights = _rule()
    places, shares = bound * nodes, bound * weights
    density = _normal(places)
    for look in range(2, looks + 1):
        reach = bound * math.sqrt(look)
        further = reach * nodes
        density = _normal(further[:, None] - places[None, :]) @ (shares * density)
        places, shares = further, reach * weights
    return float(shares @ density)


@functools.cache
def _rule() -> tuple[FloatArray, FloatArray]:
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    return nodes, weights


def _normal(places: FloatArray) -> FloatArray:
    return np.exp(-0.5 * places**2) / math.sqrt(2.0 * math.pi)


@dataclass(frozen=True)
class UntilWidth:
    """When an assessment stopped, and why.

    Attributes:
        wanted: width of the interval of the mean deviation, m.
        most_looks: greatest number of looks.
        confidence: confidence of each look's interval, such that all together hold with 95 %.
        looks: number of φ, mean deviation and its interval (m) at each.
    """

    wanted: float
    most_looks: int
    confidence: float
    looks: tuple[tuple[int, Clustered | None], ...]

    @property
    def width(self) -> float | None:
        """Width at the last look, m; None without an interval."""
        return _width(self.looks[-1][1])

    @property
    def reached(self) -> bool:
        """Whether the last interval is as narrow as it was wanted."""
        return narrow_enough(self.looks[-1][1], self.wanted)

    @property
    def text(self) -> str:
        """What came of it, in one line."""
        count, width = self.looks[-1][0], self.width
        now = "there is none" if width is None else f"it is {width:.3f} m wide"
        end = "" if self.reached else f", not {self.wanted:g} m as wanted: give more φ a batch (--safe-count)"
        return (
            f"after {count} φ the interval of the deviation: {now}{end}; intervals by φ hold at all "
            f"{self.most_looks} looks together"
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the entry of assessment.json."""
        return {
            "wanted": self.wanted,
            "reached": self.reached,
            "text": self.text,
            "most_looks": self.most_looks,
            "confidence": self.confidence,
            "looks": [
                {"safe_count": count, "deviation": found and found.value, "interval": found and found.interval}
                for count, found in self.looks
            ],
        }


def narrow_enough(found: Clustered | None, wanted: float) -> bool:
    """Return whether an interval is as narrow as wanted. One without any width is luck, and says nothing."""
    width = _width(found)
    return width is not None and 0.0 < width <= wanted


def _width(found: Clustered | None) -> float | None:
    return None if found is None or found.interval is None else found.interval[1] - found.interval[0]
