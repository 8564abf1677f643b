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

from skd_evaluator.extensions.fusion.estimate.control_variate import Line, Mean, regressed
from skd_evaluator.metrics.statistics.clustered import cluster_error, components_of, student_quantile
from skd_evaluator.metrics.statistics.statistics import checked_confidence, score_interval

LEAST_OF_EACH = 3
"""φ with a hit, and φ with a trial without one, below which a line through hits says nothing: physical trials stand
alone."""
_ADDED = 2.0


def alone_rate(groups: Sequence[FloatArray], confidence: float = 0.95) -> Mean:
    """Return the rate of hits of physical trials by themselves, every φ counting as much as any other.

    It is the mean of the φ's own rates, as that with the simulator is; somebody who drives harmless φ again and again
    does not get a safer car. Trials of one φ are at best independent of each other, so that they are no more than
    n²/Σ 1/mᵢ effective trials (m trials on each of n φ), however alike chance has made the φ. Where all φ have one rate
    nothing is known of how much less that is, and several trials of a φ are one.

    Args:
        groups: 1 for each trial of a φ with a hit, else 0; at least two φ.
        confidence: two-sided.
    """
    counts = np.array([one.size for one in groups], dtype=np.float64)
    rates = np.array([one.sum() for one in groups]) / counts
    phi = len(groups)
    components = components_of(rates, counts, math.fsum(counts * rates * (1.0 - rates)))
    error, freedom = cluster_error(rates, counts, components, np.full(phi, 1.0 / phi))
    assert error is not None
    assert freedom is not None
    rate = math.fsum(rates) / phi
    effective = float(phi)
    if error > 0.0:
        effective = min(rate * (1.0 - rate) / error**2, phi**2 / math.fsum(1.0 / counts))
    return Mean(rate, score_interval(rate, effective, student_quantile(freedom, confidence)), error)


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
    """Return whether there are enough φ with a hit, and enough with a trial without one."""
    return min(sum(bool(one.any()) for one in groups), sum(not one.all() for one in groups)) >= LEAST_OF_EACH
