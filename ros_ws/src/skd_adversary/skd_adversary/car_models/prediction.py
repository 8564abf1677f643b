"""Law or forest: which of them predicts ticks that it has not seen, and how well."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from skd_sim.arrays import BoolArray, FloatArray, IntArray
from skd_sim.kernels.compilation import kernel

from skd_adversary.car_models.car_model_file import FittedCar, Prediction
from skd_adversary.car_models.fit import fit_with_law
from skd_adversary.car_models.forest import Trees, described, forest_transform, grow, leaf_of
from skd_adversary.car_models.laws import Law, braking_probability, folds_of, integral_transform, kolmogorov_smirnov
from skd_adversary.car_models.observations import Observations
from skd_adversary.car_models.speed_change import SpeedChange, distributions, moving

FOLDS: Final = 5
"""Parts that logs are dealt out to in turn. The manoeuvres of a probe take turns by eight: none is in one part only."""
LEAST_EPISODES: Final = 2 * FOLDS
"""Fewer logs, and nothing is held out: the law it is."""
NEAR: Final = (15.0, 4.0)
"""m ahead and aside: who is nearer than that has to do with the car."""
_LOW, _STEP = -6.0, 0.02  # m/s: changes of speed over which scores are summed
_BINS = 500


def near(data: Observations) -> BoolArray:
    """Return which ticks have the road user near the car: up to 15 m ahead of or beside it, up to 4 m aside."""
    beside = np.abs(data.lateral) <= NEAR[1]
    return np.asarray(beside & (data.gap <= NEAR[0]) & (data.gap >= -data.car_length))


def learn_car(data: Observations, *, seed: int = 0, version: str = "unknown", folds: int = FOLDS) -> FittedCar:
    """Return the car that the logs show: as a law, and as a forest where that predicts it better.

    Better is by more than a standard error of the score of held-out ticks near the road user. The law has seen the
    ticks by which it is judged, the forest has not.

    Args:
        data: all ticks of all logs.
        seed: seed of every random draw.
        version: version of SKD, which the model records.
        folds: how many of the parts are predicted from the others; fewer take less time.
    """
    car, fitted = fit_with_law(data, seed=seed, version=version)
    if data.episodes < LEAST_EPISODES or not moving(data).any():
        return car
    fold, rng = folds_of(data.episode, FOLDS), np.random.default_rng(seed)
    parts = [data.of(fold == part) for part in range(folds)]
    grown = (grow(data.of(fold != part), seed=seed).trees for part in range(folds))
    by_forest = _joined([_of_forest(trees, test, rng) for trees, test in zip(grown, parts, strict=True)])
    predictions = [by_forest.prediction("forest")]
    if fitted is not None:
        by_law = _joined([_of_law(*fitted, test, rng) for test in parts])
        predictions.insert(0, by_law.prediction("law"))
        gain = by_law.scores - by_forest.scores
        _, episode = np.unique(by_law.episode, return_inverse=True)
        by_episode = np.bincount(episode, gain) if gain.size else np.zeros(1)
        if not by_episode.sum() > math.sqrt(by_episode.size) * float(by_episode.std()):
            return replace(car, predictions=tuple(predictions))
    return replace(car, forest=grow(data, seed=seed), predictions=tuple(predictions))


class _Scores(NamedTuple):
    """How well ticks were predicted: integral transforms of the moving ones, scores of those near and moving."""

    transforms: FloatArray
    is_near: BoolArray
    scores: FloatArray
    episode: IntArray

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


def _joined(parts: Sequence[_Scores]) -> _Scores:
    return _Scores(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _of_forest(trees: Trees, test: Observations, rng: np.random.Generator) -> _Scores:
    """Return how well a forest that has not seen them predicts ticks."""
    rows = moving(test)
    counted = rows & near(test)
    features, change = described(test)
    scores = np.zeros(int(counted.sum()))
    _forest_scores(*trees, features[counted], change[counted], scores, _LOW, _STEP, _BINS)
    return _Scores(forest_transform(trees, test, rows, rng), near(test)[rows], scores, test.episode[counted])


def _of_law(change: SpeedChange, law: Law, test: Observations, rng: np.random.Generator) -> _Scores:
    """Return how well a law predicts ticks."""
    rows = moving(test)
    counted = rows & near(test)
    scores = _law_scores(change, law, test)[counted]
    return _Scores(integral_transform(change, law, test, rng), near(test)[rows], scores, test.episode[counted])


def _law_scores(change: SpeedChange, law: Law, data: Observations) -> FloatArray:
    """Return the continuous ranked probability score of each tick, m/s: ∫ (F(z) − 1[observed ≤ z])² dz."""
    brakes = braking_probability(law, data)
    observed = data.speed_after - data.speed
    total = np.zeros(len(data))
    for index in range(_BINS):
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
