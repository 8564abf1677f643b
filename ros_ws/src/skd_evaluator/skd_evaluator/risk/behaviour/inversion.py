"""The interval of a behaviour model's parameter by inversion of a test: the values that the tracks do not reject.

A standard error at the estimate does not do for how much people differ in restlessness. So few of them tell little of
it, the estimate is 0 for one group in six, and the spread by chance hangs on the value itself: where the estimate is
small by chance, so is its error. So each value is tried by itself. All other parameters are fitted with it, groups of
people are simulated by them, and the tracks are held against those groups by the one number that tells of the parameter
and, to first order, of no other (the score of a C(α) test: Neyman, in Grenander, Probability and Statistics, 1959). A
value is in the interval if the tracks' number is between the groups' quantiles.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Protocol

import numpy as np
from skd_sim.arrays import FloatArray

_BISECTIONS: Final = 6
_RIDGE: Final = 1e-2
_FURTHEST: Final = 0.5
_OUTWARD: Final = 6


class Problem(Protocol):
    """What is fitted to tracks."""

    wanted: FloatArray
    """The summary of the tracks."""

    def allowed(self, free: FloatArray) -> FloatArray:
        """Return the nearest parameters within what is allowed, on the scale on which they are fitted."""

    def summary_at(self, free: FloatArray) -> FloatArray:
        """Return the summary of people simulated by parameters."""

    def jacobian_at(self, free: FloatArray) -> FloatArray:
        """Return its derivatives."""

    def groups_at(self, free: FloatArray) -> FloatArray:
        """Return the summary of each of many groups of as many people as there are tracks."""


def inverted(
    problem: Problem, free: FloatArray, index: int, error: float, most: float, confidence: float = 0.95
) -> tuple[float, float]:
    """Return the interval of a parameter that is at least 0, on the scale on which it is fitted.

    Args:
        problem: what is fitted.
        free: the estimate of all fitted parameters.
        index: of the parameter among them.
        error: its standard error, about; says where to look.
        most: greatest value allowed, on that scale.
        confidence: two-sided.
    """
    tail, weights = 0.5 * (1.0 - confidence), _weights(problem.groups_at(free))

    def above(value: float) -> float:
        """Return by how much a value is not too large: below 0 it is rejected."""
        score, groups = _score(problem, weights, free, index, value)
        return score - float(np.quantile(groups, tail))

    def below(value: float) -> float:
        score, groups = _score(problem, weights, free, index, value)
        return float(np.quantile(groups, 1.0 - tail)) - score

    inside = float(free[index])
    high, outside = inside, min(most, inside + 2.0 * error)
    for _ in range(_OUTWARD):
        if outside >= most or above(outside) < 0.0:
            break
        high, outside = outside, min(most, outside + error)
    high = _edge(above, high, outside)
    low = 0.0 if inside <= 0.0 or below(0.0) >= 0.0 else _edge(below, inside, 0.0)
    return low, high


def ridge(information: FloatArray, share: float) -> FloatArray:
    """Return what is added to an information matrix, so that steps are short and it has an inverse.

    Args:
        information: a row for each parameter.
        share: of its diagonal that is added; where that is 0, for nothing hangs on a parameter, 1 is.
    """
    diagonal = np.diag(information)
    return np.asarray(np.diag(np.where(diagonal > 0.0, share * diagonal, 1.0)))


def _edge(fine: Callable[[float], float], inside: float, outside: float) -> float:
    """Return where a function becomes negative, by bisection."""
    for _ in range(_BISECTIONS):
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if fine(middle) >= 0.0 else (inside, middle)
    return 0.5 * (inside + outside)


def _weights(groups: FloatArray) -> FloatArray:
    """Return how much each number of a summary counts: the inverse of its variance among groups."""
    return np.asarray(1.0 / (groups.var(axis=0, ddof=1) + 1e-8))


def _score(
    problem: Problem, weights: FloatArray, free: FloatArray, index: int, value: float
) -> tuple[float, FloatArray]:
    """Return what tells of the parameter, of the tracks and of groups that are simulated with a value of it."""
    here, jacobian = _others_fitted(problem, weights, free, index, value)
    groups = problem.groups_at(here)
    centre, weighed = groups.mean(axis=0), jacobian.T * _weights(groups)
    gain = (np.linalg.pinv(weighed @ jacobian) @ weighed)[index]
    return float(gain @ (problem.wanted - centre)), (groups - centre) @ gain


def _others_fitted(
    problem: Problem, weights: FloatArray, free: FloatArray, index: int, value: float
) -> tuple[FloatArray, FloatArray]:
    """Return all parameters, the others being fitted by one step, and the derivatives from which it went."""
    here = free.copy()
    here[index] = value
    here = problem.allowed(here)
    jacobian, off = problem.jacobian_at(here), problem.wanted - problem.summary_at(here)
    others = np.delete(jacobian, index, axis=1)
    information = (others.T * weights) @ others
    step = np.linalg.solve(information + ridge(information, _RIDGE), (others.T * weights) @ off)
    best = float(off @ (weights * off))
    for share in (1.0, 0.5, 0.25):
        trial = here.copy()
        trial[np.arange(here.size) != index] += np.clip(share * step, -_FURTHEST, _FURTHEST)
        trial = problem.allowed(trial)
        left = problem.wanted - problem.summary_at(trial)
        if float(left @ (weights * left)) < best:
            return trial, jacobian
    return here, jacobian
