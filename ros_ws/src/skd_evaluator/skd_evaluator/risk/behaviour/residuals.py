"""What tracks of people say about how they deviate: residuals of constant velocity, and other numbers of a group.

The residual at a horizon is how far somebody is from where the velocity of the last tick would have brought them.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
from skd_sim.arrays import FloatArray

HORIZONS: Final = (0.6, 1.2, 2.4)
"""s."""
QUANTILES: Final = (0.5, 0.95, 0.99)
_SHAPE = (0.5, 0.8, 0.95, 0.99)
_SLOW = 0.4  # of one's own brisk pace: who is slower has all but stopped
_BRISK = 0.7  # quantile of one's speeds
_LEAST = 1e-4


def padded(ways: Sequence[FloatArray]) -> FloatArray:
    """Return ways of several lengths as one array, m × longest × 2, with nan behind their ends."""
    found = np.full((len(ways), max(map(len, ways)), 2), np.nan)
    for row, way in enumerate(ways):
        found[row, : len(way)] = way
    return found


def residuals(ways: FloatArray, ticks: int) -> FloatArray:
    """Return residuals of constant velocity, m × n × 2 (along East and North), m; nan where a way is over.

    Args:
        ways: places at ticks, m × n × 2, m; nan behind the end of a way.
        ticks: the horizon.
    """
    step = ways[:, 1:-ticks] - ways[:, : -ticks - 1]
    return np.asarray(ways[:, 1 + ticks :] - ways[:, 1:-ticks] - ticks * step)


def ticks_of(horizon: float, time_step: float) -> int:
    """Return how many ticks a horizon (s) has."""
    return max(1, round(horizon / time_step))


def quantile_table(ways: FloatArray, time_step: float) -> FloatArray:
    """Return the quantiles of the length of the residuals, horizons × `QUANTILES`, m."""
    rows = [np.hypot(*np.moveaxis(residuals(ways, ticks_of(one, time_step)), -1, 0)) for one in HORIZONS]
    return np.array([np.quantile(row[np.isfinite(row)], QUANTILES) for row in rows])


def summary(ways: FloatArray, time_step: float) -> FloatArray:
    """Return the numbers by which a behaviour model is fitted to a group of tracks.

    Logarithms of quantiles of the residuals, of their part across, of how persons differ in pace, direction and
    restlessness, and of the highest speeds; and the shares, by their square roots, of ticks and of persons that all but
    stand.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # rows of nothing but nan
        return _summary(ways, time_step)


def _summary(ways: FloatArray, time_step: float) -> FloatArray:
    found: list[float] = []
    near: FloatArray | None = None
    for horizon in HORIZONS:
        both = residuals(ways, ticks_of(horizon, time_step))
        length = np.hypot(both[..., 0], both[..., 1])
        near = length if near is None else near
        found += _logs(np.quantile(length[np.isfinite(length)], _SHAPE))
        across = np.abs(both[..., 1])
        found += _logs(np.quantile(across[np.isfinite(across)], (0.5, 0.95)))
    steps = np.diff(ways, axis=1)
    speeds = np.hypot(steps[..., 0], steps[..., 1]) / time_step
    brisk = _quantile_of_rows(speeds, _BRISK)
    found.append(_log_sd(np.log(np.maximum(brisk, _LEAST))))
    whole = np.nansum(steps, axis=1)
    found.append(_log_sd(np.arctan2(whole[:, 1], whole[:, 0])))
    assert near is not None
    found.append(_log_sd(np.log(np.maximum(np.sqrt(np.nanmean(near**2, axis=1)), _LEAST))))
    relative = speeds / brisk[:, None]
    known = np.isfinite(relative)
    found += _logs(np.quantile(relative[known], (0.3, 0.5, 0.9, 0.99)))
    slow = known & (relative < _SLOW)
    found += [np.sqrt(slow.sum() / known.sum()), np.sqrt(slow.any(axis=1).mean())]
    bends = np.diff(steps[..., 1], axis=1)
    found += _logs([np.sqrt(np.nanmean(bends**2))])
    return np.array(found)


def _quantile_of_rows(values: FloatArray, share: float) -> FloatArray:
    """Return a quantile of each row, nan left out; numpy's own is slow."""
    ranked = np.sort(values, axis=1)  # nan come last
    place = share * (np.isfinite(values).sum(axis=1) - 1)
    below = np.maximum(place.astype(np.int64), 0)
    rows, above = np.arange(len(values)), np.minimum(below + 1, values.shape[1] - 1)
    low, high = ranked[rows, below], ranked[rows, above]
    return np.asarray(low + (place - below) * np.where(np.isfinite(high), high - low, 0.0))


def _logs(values: npt.ArrayLike) -> list[float]:
    return [float(one) for one in np.log(np.maximum(np.asarray(values, np.float64), _LEAST))]


def _log_sd(values: FloatArray) -> float:
    return float(np.log(max(float(np.std(values, ddof=1)), _LEAST)))
