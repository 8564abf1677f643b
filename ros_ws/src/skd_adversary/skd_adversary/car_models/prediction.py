"""Law or forest: which of them predicts ticks that it has not seen, and how well."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from skd_sim.arrays import BoolArray, FloatArray
from skd_sim.kernels.compilation import kernel

from skd_adversary.car_models.car_model_file import FittedCar, Prediction
from skd_adversary.car_models.fit import fit_with_law
from skd_adversary.car_models.forest import described, forest_transform, grow, leaf_of
from skd_adversary.car_models.laws import Law, braking_probability, folds_of, integral_transform, kolmogorov_smirnov
from skd_adversary.car_models.observations import Observations
from skd_adversary.car_models.speed_change import SpeedChange, distributions, moving

FOLDS: Final = 5
"""Parts that logs are dealt out to in turn. The manoeuvres of a probe take turns by eight: none is in one part only."""
LEAST_EPISODES: Final = 2 * FOLDS
"""Fewer logs, and nothing is held out: the law it is."""
NEAR: Final = (15.0, 4.0)
"""m ahead and aside: who is nearer than that has to do with the car."""
_LOW, _HIGH, _STEP = -6.0, 4.0, 0.02  # m/s: changes of speed over which scores are summed


def near(data: Observations) -> BoolArray:
    """Return which ticks have the road user near the car: up to 15 m ahead of or beside it, up to 4 m aside."""
    beside = np.abs(data.lateral) <= NEAR[1]
    return np.asarray(beside & (data.gap <= NEAR[0]) & (data.gap >= -data.car_length))


@dataclass(frozen=True, eq=False)
class SeenAndPredicted:
    """Ticks that were held out, and how the model of the other ticks predicts them; all arrays have length n.

    Attributes:
        gap: front bumper to the road user's centre along the lane, m.
        lateral: the road user right of the car's centre line, m.
        seen: mean acceleration of the car in the tick, m/s².
        predicted: the same, as the model expects it.
    """

    gap: FloatArray
    lateral: FloatArray
    seen: FloatArray
    predicted: FloatArray


def learn_car(
    data: Observations,
    *,
    seed: int = 0,
    version: str = "unknown",
    folds: int = FOLDS,
    progress: Callable[[int, int], None] = lambda *_steps: None,
) -> tuple[FittedCar, SeenAndPredicted | None]:
    """Return the car that the logs show: as a law, and as a forest where that predicts it better.

    With it comes how well the chosen model predicts held-out ticks; None where there are too few logs to hold any out.
    The law has seen the ticks by which it is judged, the forest has not.

    Args:
        data: all ticks of all logs.
        seed: seed of every random draw.
        version: version of SKD, which the model records.
        folds: how many of the parts are predicted from the others; fewer take less time.
        progress: told how many steps are done, of how many.
    """
    car, fitted = fit_with_law(data, seed=seed, version=version)
    if data.episodes < LEAST_EPISODES or not moving(data).any():
        return car, None
    progress(1, folds + 2)
    held_out = HeldOut(data, folds, seed, progress)
    predictions = [held_out.of_forest]
    if fitted is not None:
        predictions.insert(0, held_out.of_law(*fitted))
        if not held_out.forest_is_better:
            return replace(car, predictions=tuple(predictions)), held_out.by_law(*fitted)
    forest = grow(data, seed=seed)
    progress(folds + 2, folds + 2)
    return replace(car, forest=forest, predictions=tuple(predictions)), held_out.by_forest


@dataclass(frozen=True, eq=False)
class _Scores:
    """How well ticks were predicted: integral transforms of the moving ones, scores of those near and moving."""

    transforms: FloatArray
    is_near: BoolArray
    scores: FloatArray
    episode: FloatArray

    def prediction(self, model: str) -> Prediction:
        """Return them in figures."""
        close = self.transforms[self.is_near]
        return Prediction(
            model,
            int(self.transforms.size),
            kolmogorov_smirnov(self.transforms)[0],
            int(close.size),
            kolmogorov_smirnov(close)[0] if close.size else 0.0,
            float(self.scores.mean()) if self.scores.size else 0.0,
        )


class HeldOut:
    """Logs of which each part is predicted from the others.

    Attributes:
        of_forest: how well forests do.
        forest_is_better: whether they do better than the law that was looked at last, by more than a standard error.
        by_forest: the moving ticks, and what the forests expect in them.
    """

    def __init__(
        self, data: Observations, folds: int, seed: int, progress: Callable[[int, int], None] = lambda *_steps: None
    ) -> None:
        """Grow `folds` forests, each from the logs that one part leaves."""
        fold = folds_of(data.episode, FOLDS)
        self._rng = np.random.default_rng(seed)
        self._parts = [data.of(fold == part) for part in range(folds)]
        found: list[_Scores] = []
        expected: list[FloatArray] = []
        for part, test in enumerate(self._parts):
            trees = grow(data.of(fold != part), seed=seed).trees
            rows = moving(test)
            counted = rows & near(test)
            features, change = described(test)
            scores = np.zeros(int(counted.sum()))
            _forest_scores(*trees, features[counted], change[counted], scores, _LOW, _STEP, _bins())
            transforms = forest_transform(trees, test, rows, self._rng)
            found.append(_Scores(transforms, near(test)[rows], scores, test.episode[counted].astype(np.float64)))
            expected.append(np.zeros(int(rows.sum())))
            _forest_means(*trees, features[rows], expected[-1])
            progress(part + 2, folds + 2)
        self._forest = _joined(found)
        self.of_forest = self._forest.prediction("forest")
        self.forest_is_better = True
        self.by_forest = self._beside(expected)

    def by_law(self, change: SpeedChange, law: Law) -> SeenAndPredicted:
        """Return the moving ticks, and what a law expects in them."""
        return self._beside([_law_means(change, law, test)[moving(test)] for test in self._parts])

    def _beside(self, expected: list[FloatArray]) -> SeenAndPredicted:
        seen = [test.of(moving(test)) for test in self._parts]
        return SeenAndPredicted(
            np.concatenate([one.gap for one in seen]),
            np.concatenate([one.lateral for one in seen]),
            np.concatenate([(one.speed_after - one.speed) / one.time_step for one in seen]),
            np.concatenate([rows / one.time_step for rows, one in zip(expected, seen, strict=True)]),
        )

    def of_law(self, change: SpeedChange, law: Law) -> Prediction:
        """Return how well a law does on the same ticks."""
        found = []
        for test in self._parts:
            rows = moving(test)
            counted = rows & near(test)
            scores = _law_scores(change, law, test)[counted]
            transforms = integral_transform(change, law, test, self._rng)
            found.append(_Scores(transforms, near(test)[rows], scores, test.episode[counted].astype(np.float64)))
        whole = _joined(found)
        gain = whole.scores - self._forest.scores
        _, episode = np.unique(whole.episode, return_inverse=True)
        by_episode = np.bincount(episode, gain) if gain.size else np.zeros(1)
        error = math.sqrt(by_episode.size) * float(by_episode.std())
        self.forest_is_better = bool(by_episode.sum() > error)
        return whole.prediction("law")


def _joined(parts: list[_Scores]) -> _Scores:
    return _Scores(
        np.concatenate([one.transforms for one in parts]),
        np.concatenate([one.is_near for one in parts]),
        np.concatenate([one.scores for one in parts]),
        np.concatenate([one.episode for one in parts]),
    )


def _bins() -> int:
    return round((_HIGH - _LOW) / _STEP)


def _law_scores(change: SpeedChange, law: Law, data: Observations) -> FloatArray:
    """Return the continuous ranked probability score of each tick, m/s: ∫ (F(z) − 1[observed ≤ z])² dz."""
    brakes = braking_probability(law, data)
    observed = data.speed_after - data.speed
    total = np.zeros(len(data))
    for index in range(_bins()):
        z = _LOW + (index + 0.5) * _STEP
        free, braking = distributions(change, replace(data, speed_after=data.speed + z))
        below = np.where(z < -data.speed, 0.0, brakes * braking + (1.0 - brakes) * free)
        total += np.square(below - (observed <= z)) * _STEP
    return np.asarray(total)


@kernel
def _forest_scores(
    roots: Any,
    nodes: Any,
    donors: Any,
    features: FloatArray,
    change: FloatArray,
    scores: FloatArray,
    low: float,
    step: float,
    bins: int,
) -> None:
    """Write the same score of each tick by a forest, over the same grid."""
    mass = np.empty(bins + 1)
    for row in range(features.shape[0]):
        mass[:] = 0.0
        for root in roots:
            leaf = leaf_of(nodes, root, features[row])
            first, count = int(nodes[leaf, 1]), int(nodes[leaf, 2])
            for donor in range(first, first + count):
                place = math.ceil((donors[donor, 0] - low) / step - 0.5)  # the first z at or above it
                mass[min(bins, max(0, place))] += 1.0 / count / roots.shape[0]
        below = 0.0
        for index in range(bins):
            below += mass[index]
            above = 1.0 if change[row] <= low + (index + 0.5) * step else 0.0
            scores[row] += (below - above) * (below - above) * step


def _law_means(change: SpeedChange, law: Law, data: Observations) -> FloatArray:
    """Return the change of speed (m/s) that a law expects in each tick."""
    brakes = braking_probability(law, data)
    free = np.minimum(change.gain * (change.cruise_speed - data.speed), change.limit)
    expected = data.time_step * (brakes * -change.deceleration + (1.0 - brakes) * free)
    return np.asarray(np.maximum(expected, -data.speed))


@kernel
def _forest_means(roots: Any, nodes: Any, donors: Any, features: FloatArray, found: FloatArray) -> None:
    """Write the change of speed (m/s) that a forest expects in each tick."""
    for row in range(features.shape[0]):
        for root in roots:
            leaf = leaf_of(nodes, root, features[row])
            first, count = int(nodes[leaf, 1]), int(nodes[leaf, 2])
            total = 0.0
            for donor in range(first, first + count):
                total += donors[donor, 0]
            found[row] += total / count / roots.shape[0]
