"""How much further one car's kamikazes strayed than another's: the difference of two means over safe trajectories.

On the same φ the cars are compared φ by φ, and what makes a φ easy or hard for both drops out; where seed and numbers
of trials are the same too, so does what the draws have in common. On different φ it does not, and the difference is
known worse (Welch's test, with the degrees of freedom of Satterthwaite's rule).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import scipy

from skd_evaluator.metrics.clustered import clustered_mean, group_notes, student_quantile
from skd_evaluator.metrics.statistics import Interval, checked_confidence, mean, plain_numbers

Groups = Sequence[npt.ArrayLike]
TIE: Final = 0.5
"""Standard errors up to which a difference points nowhere: beyond, one direction is more than twice as likely."""


@dataclass(frozen=True)
class Difference:
    """The second mean less the first, with its interval over φ.

    Attributes:
        value: difference of the means over all values.
        interval: interval for the difference over all φ that there might be; None where there are too few φ.
        confidence: confidence of the interval.
        p_value: two-sided p-value of no difference; None where there are too few φ.
        standard_error: standard error of the difference.
        degrees_of_freedom: degrees of freedom of Student's t.
        effect_size: the difference in standard deviations of a single value on one φ (Cohen's d, from both cars); None
            where nothing varies.
        paired: whether the cars were compared φ by φ.
        notes: why the interval means less than it seems.
    """

    value: float
    interval: Interval | None
    confidence: float
    p_value: float | None
    standard_error: float | None
    degrees_of_freedom: float | None
    effect_size: float | None
    paired: bool
    notes: tuple[str, ...] = ()

    @property
    def direction(self) -> int:
        """1: the second is more; −1: less; 0: not significant."""
        if self.interval is None or self.interval[0] <= 0.0 <= self.interval[1]:
            return 0
        return 1 if self.value > 0.0 else -1

    @property
    def leaning(self) -> int:
        """Where the estimate points, significant or not: 1: the second is more; −1: less; 0: a tie (`TIE`)."""
        if abs(self.value) <= TIE * (self.standard_error or 0.0):
            return 0
        return 1 if self.value > 0.0 else -1

    def widened(self, below: tuple[float, float], above: tuple[float, float]) -> Difference:
        """Return the difference where each mean may be too high: by how much, and with which standard error of that.

        Args:
            below: of the second mean: the difference may be less by it.
            above: of the first mean: the difference may be more by it.
        """
        if self.interval is None or self.standard_error is None or self.degrees_of_freedom is None:
            return self
        if not any((*below, *above)):
            return self
        reach = student_quantile(self.degrees_of_freedom, self.confidence)
        low = self.value - below[0] - reach * math.hypot(self.standard_error, below[1])
        high = self.value + above[0] + reach * math.hypot(self.standard_error, above[1])
        mean_excess, error = below if self.value > 0.0 else above
        left = max(0.0, abs(self.value) - mean_excess)
        chance = _chance(left, math.hypot(self.standard_error, error), self.degrees_of_freedom)
        return replace(self, interval=(low, high), p_value=chance)

    def as_dict(self) -> dict[str, Any]:
        """Return the entry of comparison.json."""
        found = asdict(self)
        return {"difference": found.pop("value"), **found}


def difference(first: Groups, second: Groups, *, paired: bool, confidence: float = 0.95) -> Difference | None:
    """Return how much larger the second mean is than the first.

    Args:
        first: the values of each φ, of one car.
        second: the same for the second car; with `paired`, on the same φ in the same order.
        paired: whether to compare φ by φ.
        confidence: two-sided, in (0, 1).

    Returns:
        None where one of them has no value.

    Raises:
        ValueError: values that are not plain lists of finite numbers, groups that do not pair, or a confidence outside
            (0, 1).
    """
    checked_confidence(confidence)
    ours, theirs = list(map(plain_numbers, first)), list(map(plain_numbers, second))
    if paired and len(ours) != len(theirs):
        raise ValueError(f"{len(ours)} and {len(theirs)} φ do not pair")
    if not (any(one.size for one in ours) and any(one.size for one in theirs)):
        return None
    value = mean(np.concatenate(theirs)) - mean(np.concatenate(ours))
    error, freedom, notes = _paired(ours, theirs) if paired else _apart(ours, theirs)
    interval, chance = None, None
    if error is not None and freedom is not None:
        half = student_quantile(freedom, confidence) * error
        interval = (value - half, value + half)
        chance = _chance(value, error, freedom)
    return Difference(
        value, interval, confidence, chance, error, freedom, _effect_size(ours, theirs, value), paired, tuple(notes)
    )


def _chance(value: float, error: float, freedom: float) -> float:
    if error == 0.0:
        return 1.0 if value == 0.0 else 0.0
    return float(2.0 * scipy.special.stdtr(freedom, -abs(value) / error))


def _paired(ours: Sequence[Any], theirs: Sequence[Any]) -> tuple[float | None, float | None, list[str]]:
    """Return standard error and degrees of freedom of the difference of pooled means, from what each φ does to it.

    A φ moves each mean by its share of the values times how far its own mean is off; the sum of squares of these, times
    m/(m − 1), is the squared error. With equally many values for each φ that is the paired t test.
    """
    both = [(one, other) for one, other in zip(ours, theirs, strict=True) if one.size and other.size]
    notes = group_notes(len(both), len(ours))
    if len(both) < 2:
        return None, None, notes
    moved = np.zeros(len(both))
    for sign, side in ((-1.0, [one for one, _ in both]), (1.0, [other for _, other in both])):
        counts = np.array([group.size for group in side], dtype=np.float64)
        means = np.array([mean(group) for group in side])
        shares = counts / counts.sum()
        moved += sign * shares * (means - math.fsum(shares * means))
    if np.ptp(moved) < 1e-12 * max(1.0, max(float(np.abs(group).max()) for pair in both for group in pair)):
        moved[:] = 0.0  # rounding
        notes.append("the difference is the same for every φ: its interval has no width")
    return math.sqrt(math.fsum(moved**2) * len(both) / (len(both) - 1)), len(both) - 1.0, notes


def _apart(ours: Sequence[Any], theirs: Sequence[Any]) -> tuple[float | None, float | None, list[str]]:
    """Return standard error and degrees of freedom of the difference of two means that have nothing in common."""
    found = [clustered_mean(side) for side in (ours, theirs)]
    notes = list(dict.fromkeys(note for one in found if one is not None for note in one.notes))
    squares, freedoms = [], []
    for one in found:
        if one is None or one.standard_error is None or one.degrees_of_freedom is None:
            return None, None, notes
        squares.append(one.standard_error**2)
        freedoms.append(one.degrees_of_freedom)
    total = sum(squares)
    if total == 0.0:
        return 0.0, sum(freedoms), notes
    freedom = total**2 / sum(square**2 / degrees for square, degrees in zip(squares, freedoms, strict=True))
    return math.sqrt(total), freedom, notes


def _effect_size(ours: Sequence[Any], theirs: Sequence[Any], value: float) -> float | None:
    """Return the difference in standard deviations of the values of one φ, pooled over both cars and all φ."""
    groups = [group for group in (*ours, *theirs) if group.size]
    freedom = sum(group.size - 1 for group in groups)
    inside = math.fsum(math.fsum((group - mean(group)) ** 2) for group in groups)
    return value / math.sqrt(inside / freedom) if freedom > 0 and inside > 0.0 else None
