"""How many physical trials a wanted width takes, alone and with a simulator that predicts so well."""

from __future__ import annotations

import math

from skd_evaluator.extensions.fusion.estimate.control_variate import LEAST_PAIRS
from skd_evaluator.metrics.statistics.clustered import student_quantile

MOST = 10_000
"""φ with physical trials beyond which nobody is advised."""


def width_alone(trials: int, deviation: float, confidence: float = 0.95) -> float:
    """Return how wide the interval of physical trials alone is expected to be, one trial on each φ.

    Args:
        trials: number of φ with a trial.
        deviation: standard deviation of the figure from φ to φ.
        confidence: two-sided.
    """
    freedom = trials - 1.0
    return 2.0 * student_quantile(freedom, confidence) * _root(freedom) * deviation / math.sqrt(trials)


def width_fused(trials: int, deviation: float, correlation: float, simulated: int, confidence: float = 0.95) -> float:
    """Return how wide the interval with the simulator is expected to be.

    The mean of (x̄ of all − x̄ of the n)²/Sxx over normal pairs is 1/(n (n − 3)).

    Args:
        trials: number of φ with a trial, ≥ 5.
        deviation: standard deviation of the physical figure from φ to φ.
        correlation: of physical and simulated figure.
        simulated: number of simulated φ.
        confidence: two-sided.
    """
    freedom = trials - 2.0
    left = (1.0 - correlation**2) / trials * (1.0 + 1.0 / (trials - 3.0)) * _root(freedom) ** 2
    return 2.0 * student_quantile(freedom, confidence) * deviation * math.sqrt(left + correlation**2 / simulated)


def trials_for_width(
    width: float, deviation: float, correlation: float | None = None, simulated: int = 0, confidence: float = 0.95
) -> int | None:
    """Return the least number of φ with a physical trial whose interval is expected to be so narrow.

    Args:
        width: that is wanted.
        deviation: of the figure from φ to φ.
        correlation: of physical and simulated figure; None: the physical trials stand alone.
        simulated: number of simulated φ.
        confidence: two-sided.

    Returns:
        None where even `MOST` are not enough: fewer simulated φ than the width takes, or too little a width.
    """

    def enough(trials: int) -> bool:
        if correlation is None:
            return width_alone(trials, deviation, confidence) <= width
        return width_fused(trials, deviation, correlation, simulated, confidence) <= width

    most = MOST if correlation is None else min(MOST, simulated)
    if most < LEAST_PAIRS or not enough(most):
        return None
    low, high = LEAST_PAIRS - 1, most
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if enough(middle) else (middle, high)
    return high


def _root(freedom: float) -> float:
    """Return the mean of an estimated standard deviation over the true one."""
    return math.sqrt(2.0 / freedom) * math.exp(math.lgamma((freedom + 1.0) / 2.0) - math.lgamma(freedom / 2.0))
