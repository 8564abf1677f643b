"""Of the pairs of cars that several truths order alike: how many does a figure order so?

A truth says of two cars that one is safer where it hits in fewer of the same runs and a sign test over the runs in
which the two differ (McNemar's, exact, two-sided) gives less than 5 %. A pair counts where every truth says so of the
same car. A figure orders a pair as it should where it is strictly better for the safer car: a tie is an exception. The
interval of the share is a bootstrap over cars, not pairs: one car that a figure has wrong takes part in many pairs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.stats import binomtest

SIGNIFICANT = 0.05
RESAMPLES = 10_000


class Pair(NamedTuple):
    """Two cars that all truths order alike, by their numbers."""

    safer: int
    other: int


class Share(NamedTuple):
    """How many of the pairs a figure orders as the truths do.

    Attributes:
        pairs: that count and for which the figure is known.
        right: that it orders so.
        exceptions: the others, ties included.
        interval: 95 %, for the share; None below two cars.
    """

    pairs: int
    right: int
    exceptions: tuple[Pair, ...]
    interval: tuple[float, float] | None

    @property
    def value(self) -> float:
        """The share; nan where no pair counts."""
        return self.right / self.pairs if self.pairs else float("nan")


def safer_of(first: npt.NDArray[np.bool_], second: npt.NDArray[np.bool_]) -> int:
    """Return which of two cars is significantly safer in the same runs: 0, 1, or −1 where neither is.

    Args:
        first: whether the first car hit, a boolean for each run.
        second: likewise, the other car's in the same runs.
    """
    only_first, only_second = int((first & ~second).sum()), int((second & ~first).sum())
    differ = only_first + only_second
    if differ == 0 or binomtest(only_first, differ).pvalue >= SIGNIFICANT:
        return -1
    return 0 if only_first < only_second else 1


def agreed_pairs(truths: Sequence[Sequence[npt.NDArray[np.bool_]]]) -> list[Pair]:
    """Return the pairs of cars that all truths order alike.

    Args:
        truths: for each truth, for each car, whether it hit in each run.
    """
    found = []
    for first, second in combinations(range(len(truths[0])), 2):
        said = {safer_of(hits[first], hits[second]) for hits in truths}
        if said == {0}:
            found.append(Pair(first, second))
        elif said == {1}:
            found.append(Pair(second, first))
    return found


def ordered_share(pairs: Sequence[Pair], figure: Mapping[int, float], better: int, seed: int = 0) -> Share:
    """Return how many of the pairs a figure orders as the truths do.

    Args:
        pairs: that all truths order alike.
        figure: of each car for which it is known.
        better: +1 where more of it is safer, −1 where less is.
        seed: of the bootstrap.
    """
    known = [pair for pair in pairs if pair.safer in figure and pair.other in figure]
    right = np.array([better * (figure[pair.safer] - figure[pair.other]) > 0.0 for pair in known], dtype=bool)
    exceptions = tuple(pair for pair, fine in zip(known, right, strict=True) if not fine)
    return Share(len(known), int(right.sum()), exceptions, _interval(known, right, sorted(figure), seed))


def _interval(
    pairs: Sequence[Pair], right: npt.NDArray[np.bool_], cars: Sequence[int], seed: int
) -> tuple[float, float] | None:
    """Return the percentile interval over cars drawn with replacement: a pair counts as often as both are drawn."""
    if len(cars) < 2 or not pairs:
        return None
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    place = {car: number for number, car in enumerate(cars)}
    safer = np.array([place[pair.safer] for pair in pairs])
    other = np.array([place[pair.other] for pair in pairs])
    drawn = rng.multinomial(len(cars), np.full(len(cars), 1.0 / len(cars)), size=RESAMPLES)
    weights = drawn[:, safer] * drawn[:, other]
    totals = weights.sum(axis=1)
    shares = (weights @ right)[totals > 0] / totals[totals > 0]
    low, high = np.quantile(shares, [0.025, 0.975])
    return float(low), float(high)
