"""The equivalent multiplier: the C of the basic car that has the same mean deformation on the same safe trajectories.

The basic car is swept over C. Its mean deformation rises with C but for chance, so the means are made monotone
(isotonic regression, weighted by attempts: Barlow et al. 1972), joined by straight lines and read backwards.

The interval is a bootstrap of the whole procedure, sweep and regression included. *These φ* are what the figure speaks
of, so attempts are drawn anew within each φ and every φ stays in: were whole φ drawn as well, the chance within them
would be counted twice, and the interval would be a third too wide for a handful of φ. Attempts of one number share the
car's start and its noise, so they are drawn together, for the car and for every C of the sweep; only where the seeds
differ are they drawn apart. A second interval draws whole φ, jointly for car and sweep: what other φ might have said.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
RESAMPLES = 2000


@dataclass(frozen=True)
class EquivalentMultiplier:
    """C, or on which side of the sweep it would lie.

    Attributes:
        value: C; minus or plus infinity below or above the sweep.
        ci95: 95 % interval for these φ; an end beyond the sweep is infinite.
        ci95_clustered: 95 % bootstrap interval over φ; None below two φ.
        lowest: least C of the sweep.
        highest: greatest C of the sweep.
    """

    value: float
    ci95: tuple[float, float]
    ci95_clustered: tuple[float, float] | None
    lowest: float
    highest: float

    @property
    def text(self) -> str:
        """C as people read it: a number, `below 0.5` or `above 1.5`."""
        return self._side(self.value) or f"{self.value:.3f}"

    def interval_text(self, interval: tuple[float, float]) -> str:
        """Return an interval as people read it; an end beyond the sweep is said to be there."""
        return f"[{', '.join(self._side(end) or f'{end:.3f}' for end in interval)}]"

    def _side(self, value: float) -> str:
        if math.isfinite(value):
            return ""
        return f"above {self.highest:g}" if value > 0.0 else f"below {self.lowest:g}"


def equivalent_entries(found: EquivalentMultiplier | None) -> dict[str, Any]:
    """Return the entries of assessment.json; what lies beyond the sweep is null there, and the texts say where."""
    name = "equivalent_multiplier"
    if found is None:
        ends = ("", "_text", "_ci95", "_ci95_clustered", "_ci95_text", "_ci95_clustered_text")
        return dict.fromkeys(f"{name}{end}" for end in ends)
    return {
        name: _finite(found.value),
        f"{name}_text": found.text,
        f"{name}_ci95": [_finite(end) for end in found.ci95],
        f"{name}_ci95_clustered": found.ci95_clustered and [_finite(end) for end in found.ci95_clustered],
        f"{name}_ci95_text": found.interval_text(found.ci95),
        f"{name}_ci95_clustered_text": found.ci95_clustered and found.interval_text(found.ci95_clustered),
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def equivalent_multiplier(
    car: Sequence[npt.ArrayLike],
    multipliers: Sequence[float],
    sweep: Sequence[Sequence[npt.ArrayLike]],
    *,
    paired: bool,
    seed: int | np.random.SeedSequence = 0,
    resamples: int = RESAMPLES,
) -> EquivalentMultiplier:
    """Return the multiplier of the basic car that deforms these φ as much as a car does.

    Args:
        car: per φ, the deformation of each attempt in the order of their numbers, m; failed ones are η_max, nan is an
            attempt that says nothing, as an aborted one.
        multipliers: the C of the sweep, ascending, at least two.
        sweep: per C and φ likewise, of the basic car.
        paired: whether attempts of one number share their draws in the car's and in the sweep's episodes.
        seed: of the bootstrap.
        resamples: of the bootstrap.

    Raises:
        ValueError: multipliers that do not ascend, lists of different lengths, or a car without an attempt.
    """
    grid = np.asarray(multipliers, dtype=np.float64)
    if grid.size < 2 or not (np.diff(grid) > 0.0).all():
        raise ValueError("the sweep needs at least two multipliers, in ascending order")
    if len(sweep) != grid.size or not car or any(len(one) != len(car) for one in sweep):
        raise ValueError("the sweep needs the attempts of each multiplier for each φ of the car")
    tables = [_table([car[index], *(one[index] for one in sweep)]) for index in range(len(car))]
    sequence = seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
    rng = np.random.default_rng(sequence)
    sums = np.array([np.nansum(table, axis=0) for table in tables])  # φ × (car, C …)
    counts = np.array([(~np.isnan(table)).sum(axis=0) for table in tables], dtype=np.float64)
    if (counts.sum(axis=0) == 0).any():
        raise ValueError("the car, or a multiplier of the sweep, has no attempt")
    value = _read(grid, sums.sum(axis=0)[None], counts.sum(axis=0)[None])[0]
    within_sums = np.zeros((resamples, grid.size + 1))
    within_counts = np.zeros_like(within_sums)
    for table in tables:
        drawn_sums, drawn_counts = _drawn_attempts(table, resamples, rng, paired=paired)
        within_sums += drawn_sums
        within_counts += drawn_counts
    within = _ends(_read(grid, within_sums, within_counts))
    clustered = None
    if len(car) >= 2:
        drawn = rng.integers(len(car), size=(resamples, len(car)))
        clustered = _ends(_read(grid, sums[drawn].sum(axis=1), counts[drawn].sum(axis=1)))
    return EquivalentMultiplier(float(value), within, clustered, float(grid[0]), float(grid[-1]))


def _table(columns: Sequence[npt.ArrayLike]) -> FloatArray:
    """Return attempts × (car, C …), nan where there is none."""
    lists = [np.asarray(column, dtype=np.float64) for column in columns]
    table = np.full((max(len(one) for one in lists), len(lists)), np.nan)
    for index, one in enumerate(lists):
        table[: len(one), index] = one
    return table


def _drawn_attempts(
    table: FloatArray, resamples: int, rng: np.random.Generator, *, paired: bool
) -> tuple[FloatArray, FloatArray]:
    """Return sums and counts (resamples × columns) of the attempts of one φ drawn with replacement."""
    known = ~np.isnan(table)
    values = np.where(known, table, 0.0)
    if paired:
        weights = _weights(len(table), resamples, rng)
        return weights @ values, weights @ known.astype(np.float64)
    sums, counts = np.empty((resamples, table.shape[1])), np.empty((resamples, table.shape[1]))
    for columns in (slice(0, 1), slice(1, None)):
        weights = _weights(len(table), resamples, rng)
        sums[:, columns] = weights @ values[:, columns]
        counts[:, columns] = weights @ known[:, columns].astype(np.float64)
    return sums, counts


def _weights(attempts: int, resamples: int, rng: np.random.Generator) -> FloatArray:
    """Return how often each attempt is drawn, resamples × attempts.

    Of n attempts n − 1 are drawn: then the variance is not too small by a factor of (n − 1)/n (Rao and Wu 1988).
    """
    size = (resamples, max(1, attempts - 1))
    drawn = rng.integers(attempts, size=size) + attempts * np.arange(resamples)[:, None]
    counts = np.bincount(drawn.ravel(), minlength=resamples * attempts)
    return counts.reshape(resamples, attempts).astype(np.float64)


def _read(grid: FloatArray, sums: FloatArray, counts: FloatArray) -> FloatArray:
    """Return C of each row; rows are the sums and counts of the car, then of each C of the sweep.

    Rows in which one of them has no attempt say nothing, and are left out.
    """
    some = (counts > 0.0).all(axis=1)
    sums, counts = sums[some], counts[some]
    return _inverse(grid, isotonic_means(sums[:, 1:], counts[:, 1:]), sums[:, 0] / counts[:, 0])


def isotonic_means(sums: FloatArray, counts: FloatArray) -> FloatArray:
    """Return the isotonic regression of each row's means, weighted by counts, all rows at once.

    f_i = max over j ≤ i of min over k ≥ i of the mean over j … k (Barlow et al. 1972, section 1.2).

    Args:
        sums: rows × columns.
        counts: likewise, positive.
    """
    columns = sums.shape[1]
    start = np.zeros((len(sums), 1))
    below = np.hstack([start, np.cumsum(sums, axis=1)])
    weight = np.hstack([start, np.cumsum(counts, axis=1)])
    fitted = np.full(sums.shape, -math.inf)
    for first in range(columns):
        means = (below[:, first + 1 :] - below[:, [first]]) / (weight[:, first + 1 :] - weight[:, [first]])
        least = np.minimum.accumulate(means[:, ::-1], axis=1)[:, ::-1]
        np.maximum(fitted[:, first:], least, out=fitted[:, first:])
    return fitted


def _inverse(grid: FloatArray, fitted: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return where each row's rising polyline reaches its value: in the middle, where it stays there for a while."""
    rows = np.arange(len(fitted))
    first, after = (fitted < wanted[:, None]).sum(axis=1), (fitted <= wanted[:, None]).sum(axis=1)
    last = grid.size - 1
    left, right = np.clip(first - 1, 0, last), np.minimum(first, last)
    low, high = fitted[rows, left], fitted[rows, right]
    share = np.divide(wanted - low, high - low, out=np.zeros(len(rows)), where=high > low)
    found = grid[left] + share * (grid[right] - grid[left])
    found = np.where(after > first, 0.5 * (grid[right] + grid[np.maximum(after - 1, 0)]), found)
    return np.where(first > last, math.inf, np.where(after == 0, -math.inf, found))


def _ends(values: FloatArray) -> tuple[float, float]:
    """Return the 2.5 and 97.5 % quantiles; values may be infinite, so order statistics, not weighted ones."""
    low, high = np.quantile(values, [0.025, 0.975], method="inverted_cdf")
    return float(low), float(high)
