"""Growing the forest of a car (`car_forest`) from its ticks."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt
from skd_sim.arrays import BoolArray, FloatArray
from skd_sim.kernels.compilation import kernel

from skd_adversary.car_models.car_forest import (
    FEATURES,
    GRID,
    CarForest,
    Trees,
    from_grid,
    gridded,
    leaf_of,
    pack,
    tick_features,
)
from skd_adversary.car_models.observations import Observations

TREES: Final = 40
LEAST_DONORS: Final = 5
"""In a leaf."""


def kept_ticks(data: Observations) -> npt.NDArray[np.int16]:
    """Return the ticks as a forest keeps them, n × 7."""
    columns = (
        data.gap,
        data.lateral,
        data.walking_sideways,
        data.walking_away,
        data.speed,
        data.speed_after - data.speed,
        data.travelled - 0.5 * data.time_step * (data.speed + data.speed_after),
    )
    return gridded(np.column_stack(columns))


def lengths_of(data: Observations) -> npt.NDArray[np.int64]:
    """Return the number of ticks of each episode."""
    begins = np.flatnonzero(data.tick == 0)
    return np.diff(np.append(begins, len(data))).astype(np.int64)


def described(data: Observations) -> tuple[FloatArray, FloatArray]:
    """Return features (n × 14) and change of speed of ticks, as a forest sees them."""
    ticks = from_grid(kept_ticks(data))
    features = np.empty((len(ticks), len(FEATURES)))
    tick_features(ticks, lengths_of(data), features)
    return features, ticks[:, 5]


def grow(data: Observations, *, seed: int = 0) -> CarForest:
    """Return the forest of some ticks; the same ticks always give the same forest.

    Args:
        data: ticks of whole episodes.
        seed: seed of the random draws.
    """
    from sklearn.ensemble import RandomForestRegressor  # slow to import, and needed only now

    features, change = described(data)
    whole = np.ceil(features * GRID - 0.5)  # what can be told apart; halves go down, as in `leaf_of`
    forest = RandomForestRegressor(TREES, min_samples_leaf=LEAST_DONORS, random_state=seed, n_jobs=1)
    forest.fit(whole.astype(np.float32), change)
    grown: list[Any] = [tree.tree_ for tree in forest.estimators_]
    for tree in grown:
        splits = tree.children_left >= 0
        if (tree.children_left[splits] != np.flatnonzero(splits) + 1).any():
            raise RuntimeError("scikit-learn's trees no longer stand depth first")
    feature = np.concatenate([np.where(tree.children_left >= 0, tree.feature, -1) for tree in grown])
    threshold = np.concatenate([tree.threshold[tree.children_left >= 0] for tree in grown])
    return pack(
        feature.astype(np.int8),
        np.clip(np.floor(threshold), -32767, 32767).astype(np.int16),
        np.array([tree.node_count for tree in grown], dtype=np.uint32),
        kept_ticks(data),
        lengths_of(data).astype(np.uint16),
        time_step=data.time_step,
        car_length=data.car_length,
    )


@kernel
def _positions(
    roots: npt.NDArray[np.int64],
    nodes: Any,
    donors: Any,
    features: FloatArray,
    change: FloatArray,
    below: FloatArray,
    equal: FloatArray,
) -> None:
    """Write the probability that a forest gives to changes below, and equal to, those of ticks."""
    for row in range(features.shape[0]):
        for root in roots:
            leaf = leaf_of(nodes, root, features[row])
            first, count = int(nodes[leaf, 1]), int(nodes[leaf, 2])
            less, same = 0, 0
            for donor in range(first, first + count):
                if donors[donor, 0] < change[row]:
                    less += 1
                elif donors[donor, 0] == change[row]:
                    same += 1
            below[row] += less / count / roots.shape[0]
            equal[row] += same / count / roots.shape[0]


def forest_transform(trees: Trees, data: Observations, rows: BoolArray, rng: np.random.Generator) -> FloatArray:
    """Return the predicted distribution function at the changes of speed of some ticks: uniform, if it is right.

    Args:
        trees: trees of a forest that has not seen these ticks.
        data: all ticks of whole episodes.
        rows: the ticks of interest.
        rng: draws where a change of speed has a probability of its own.
    """
    features, change = described(data)
    below, equal = np.zeros(int(rows.sum())), np.zeros(int(rows.sum()))
    _positions(*trees, features[rows], change[rows], below, equal)
    return np.asarray(np.minimum(1.0, below + equal * rng.random(below.size)))
