"""How far the simulator is off: the physical figure less the simulated one, per φ, on average and as a trend."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import scipy
from skd_sim.arrays import FloatArray

from skd_evaluator.metrics.statistics.clustered import student_quantile
from skd_evaluator.metrics.statistics.statistics import Interval


@dataclass(frozen=True)
class Trend:
    """How a gap changes with something.

    Attributes:
        slope: of the line of least squares, in the unit of the gap per unit of what it is held against.
        interval: of the slope, by Student's t.
        p_value: two-sided, of no trend.
    """

    slope: float
    interval: Interval
    p_value: float


@dataclass(frozen=True, eq=False)
class Gap:
    """Physical less simulated figure.

    Attributes:
        by_phi: of each φ, in the order of the pairs.
        mean: over these φ.
        interval: of the mean, by Student's t; None where all gaps are the same.
        by_simulated: whether it grows with the simulated figure: 0 where the simulator is off by the same everywhere.
        by_order: whether it grows from trial to trial, per trial: brakes that warm up, a track that dries.
    """

    by_phi: FloatArray
    mean: float
    interval: Interval | None
    by_simulated: Trend | None
    by_order: Trend | None

    def as_dict(self) -> dict[str, Any]:
        """Return the entry of fusion.json."""
        trends = {
            name: one and asdict(one)
            for name, one in (("by_simulated", self.by_simulated), ("by_order", self.by_order))
        }
        return {"mean": self.mean, "interval": self.interval, **trends}


def gap_of(y: FloatArray, x: FloatArray, trials: FloatArray, predicted: FloatArray, confidence: float = 0.95) -> Gap:
    """Return the gap of pairs.

    Args:
        y: physical figures, one of each φ.
        x: simulated figures of the same φ.
        trials: physical figures of each trial, in the order in which they were made.
        predicted: what the simulator says of each of these trials.
        confidence: of the intervals, two-sided.
    """
    gaps = y - x
    centre, deviation = float(gaps.mean()), float(gaps.std(ddof=1))
    half = student_quantile(gaps.size - 1.0, confidence) * deviation / math.sqrt(gaps.size)
    interval = (centre - half, centre + half) if half > 0.0 else None
    order = trend(np.arange(trials.size, dtype=np.float64), trials - predicted, confidence)
    return Gap(gaps, centre, interval, trend(x, gaps, confidence), order)


def trend(places: FloatArray, values: FloatArray, confidence: float = 0.95) -> Trend | None:
    """Return the line of least squares of values over places; None where the places or the values are all the same."""
    off, up = places - places.mean(), values - values.mean()
    spread, freedom = float(off @ off), places.size - 2.0
    if spread <= 0.0 or freedom < 1.0 or not np.ptp(values) > 1e-9 * float(np.abs(values).max()):
        return None
    slope = float(off @ up) / spread
    left = up - slope * off
    error = math.sqrt(float(left @ left) / freedom / spread)
    half = student_quantile(freedom, confidence) * error
    chance = 0.0 if error == 0.0 else float(2.0 * scipy.special.stdtr(freedom, -abs(slope) / error))
    return Trend(slope, (slope - half, slope + half), chance)
