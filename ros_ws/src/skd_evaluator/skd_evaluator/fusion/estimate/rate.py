"""How often the physical car hits, from few trials and a simulator: the control variate with a score interval.

A rate's interval has to stay in [0, 1] and to hold near its ends, so the squared error of the regression estimator is
turned into an effective number of trials, as in `measure.statistics.clustered_rate`. Pairs that a simulator predicts
well leave no residuals although it will be wrong some day: as Agresti and Coull (The American Statistician 52, 1998) do
for a plain rate, two trials in which it was wrong are added to the residual variance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from skd_sim.arrays import FloatArray

from skd_evaluator.fusion.estimate.control_variate import Line, Mean, regressed
from skd_evaluator.measure.statistics.clustered import student_quantile
from skd_evaluator.measure.statistics.clustered_rate import clustered_rate
from skd_evaluator.measure.statistics.statistics import checked_confidence, score_interval

LEAST_OF_EACH = 3
"""Trials with a hit, and trials without, below which a line through hits says nothing: physical trials stand alone."""
_ADDED = 2.0


def alone_rate(groups: Sequence[FloatArray], confidence: float = 0.95) -> Mean:
    """Return the rate of hits of physical trials by themselves, every trial counting as much as any other.

    Args:
        groups: 1 for each trial of a φ with a hit, else 0; at least two φ.
        confidence: two-sided.
    """
    found = clustered_rate([(int(one.sum()), one.size) for one in groups], confidence)
    assert found is not None
    assert found.interval is not None
    assert found.standard_error is not None
    return Mean(found.value, found.interval, found.standard_error)


def fused_rate(y: FloatArray, x: FloatArray, population: FloatArray, line: Line, confidence: float = 0.95) -> Mean:
    """Return the rate of hits over all φ from pairs and from every simulated rate; arguments as of `fused`."""
    quantile = student_quantile(y.size - 2.0, checked_confidence(confidence))
    centre = float(np.clip(math.fsum(y) / y.size, 1e-6, 1.0 - 1e-6))
    freedom = y.size - 2.0
    residual = (line.residual * freedom + _ADDED * centre * (1.0 - centre)) / (freedom + _ADDED)
    value, error, _ = regressed(y, x, population, line, residual)
    rate = float(np.clip(value, 1e-6, 1.0 - 1e-6))
    low, high = score_interval(rate, rate * (1.0 - rate) / error**2, quantile)
    return Mean(min(1.0, max(0.0, value)), (low, high), error)


def enough_of_each(groups: Sequence[FloatArray]) -> bool:
    """Return whether there are enough trials with a hit, and enough without one."""
    trials = np.concatenate(groups)
    return LEAST_OF_EACH <= int(trials.sum()) <= trials.size - LEAST_OF_EACH
