"""A surrogate model of a controller: the acceleration that was seen in the situation most like this one.

A sample is one simulated tick of the car: the situation as the car could see it, and the acceleration that followed,
freed of the tick's known noise. A situation is the gap ahead of the front, how far to the right the road user is, the
car's speed, its acceleration in the tick before, and the road user's velocity to the right and along the road: that of
the tick before for a car that decides once a tick, of this tick for one that decides within it. The answer is that of
the nearest sample. Situations are relative to the car, so samples of other episodes teach as well.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel

SITUATION: Final = 6
"""Numbers of a situation; the seventh of a sample is the acceleration, m/s²."""
WEIGHTS: Final = (1.0, 1.0, 1.0, 0.3, 0.25, 0.25)
RADIUS: Final = 1.5
"""Weighted distance beyond which a sample tells nothing."""
_SURPRISE = 0.25, 0.1  # m/s² that an answer may be off before it is kept: of a car that decides once a tick, or within
_LOOKED = 48
_CANDIDATES, _ASKED = 12, 64
_MOST = 2000  # samples
_KEPT, _DROPPED, _SPREAD = 0.5, 0.1, 0.5  # share of numbers that count, factor of the others, log-normal


@kernel
def nearest_sample(
    samples: FloatArray, count: int, weights: FloatArray, situation: FloatArray, without: int = -1
) -> tuple[int, float]:
    """Return the number of the nearest sample (−1: there is none), and its weighted distance.

    Only the `_LOOKED` samples whose gaps are nearest are looked at.

    Args:
        samples: at least `count` × 7 numbers, in the order of the first column.
        count: how many of the samples count.
        weights: weights of a situation's 6 numbers.
        situation: the 6 numbers of the situation.
        without: number of a sample that is left out; −1: none is.
    """
    low, high = 0, count
    gap, first = situation[0], weights[0]
    while low < high:
        middle = (low + high) // 2
        if samples[middle, 0] < gap:
            low = middle + 1
        else:
            high = middle
    best, least = -1, math.inf
    below, above = low - 1, low
    looked = 0
    while (below >= 0 or above < count) and looked < _LOOKED:
        looked += 1
        down = first * (gap - samples[below, 0]) if below >= 0 else math.inf
        up = first * (samples[above, 0] - gap) if above < count else math.inf
        away = min(down, up)
        if away * away >= least:
            break
        if down <= up:
            row, below = below, below - 1
        else:
            row, above = above, above + 1
        if row == without:
            continue
        squared = away * away
        for i in range(1, SITUATION):
            difference = weights[i] * (situation[i] - samples[row, i])
            squared += difference * difference
        if squared < least:
            best, least = row, squared
    return best, math.sqrt(least)


@kernel
def left_out_error(samples: FloatArray, count: int, weights: FloatArray, most: int) -> float:
    """Return how far off a sample's acceleration the nearest other one's is, on average over `most` samples, m/s²."""
    total, compared = 0.0, 0
    stride = max(1, count // most)
    for row in range(0, count, stride):
        other, _ = nearest_sample(samples, count, weights, samples[row], row)
        if other >= 0:
            total += abs(samples[other, SITUATION] - samples[row, SITUATION])
            compared += 1
    return total / max(1, compared)


@kernel
def _learn(
    samples: FloatArray, count: int, weights: FloatArray, situations: FloatArray, seen: FloatArray, surprise: float
) -> int:
    """Insert what was not predicted into samples, in the order of their gaps; return how many there are then."""
    for i in range(seen.shape[0]):
        row, away = nearest_sample(samples, count, weights, situations[i])
        if row >= 0 and away < 0.5 * RADIUS and abs(samples[row, SITUATION] - seen[i]) <= surprise:
            continue
        if count == samples.shape[0]:
            return count
        at = count
        while at > 0 and samples[at - 1, 0] > situations[i, 0]:
            samples[at] = samples[at - 1]
            at -= 1
        samples[at, :SITUATION] = situations[i]
        samples[at, SITUATION] = seen[i]
        count += 1
    return count


class Surrogate:
    """Samples of one controller, in the order of their gaps."""

    def __init__(self, within_ticks: bool) -> None:
        """Begin without samples, of a car that decides within a tick or only at its begin."""
        self.rows, self.count = np.empty((_MOST, SITUATION + 1)), 0
        self._surprise = _SURPRISE[1] if within_ticks else _SURPRISE[0]
        self._weights = np.array(WEIGHTS)

    def learn(self, situations: FloatArray, accelerations: FloatArray) -> None:
        """Keep what was seen unless it was predicted."""
        self.count = _learn(self.rows, self.count, self._weights, situations, accelerations, self._surprise)

    def telling_weights(self, rng: np.random.Generator) -> FloatArray:
        """Return those of some random weights by which samples predict each other best.

        Some numbers of a situation mean next to nothing to a controller, and which these are differs.
        """
        found, least = self._weights, math.inf
        for _ in range(_CANDIDATES):
            kept = np.where(rng.random(SITUATION) < _KEPT, 1.0, _DROPPED)
            weights = self._weights * kept * np.exp(_SPREAD * rng.standard_normal(SITUATION))
            error = left_out_error(self.rows, self.count, weights, _ASKED)
            if error < least:
                found, least = weights, error
        return found
