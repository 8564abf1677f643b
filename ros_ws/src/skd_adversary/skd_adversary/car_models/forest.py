"""A car as a forest of regression trees: what it did in the recorded ticks that were most like the present one.

There is no law in it. A tick's features go down a tree to a leaf, where some recorded ticks lie, the *donors*; what the
car did in one of them is what it is thought to do (quantile regression forests, Meinshausen 2006). A file holds the
trees' splits and the recorded ticks; which donors lie where follows.
"""

from __future__ import annotations

import functools
import io
import zipfile
import zlib
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from skd_sim.errors import UsageError
from skd_sim.kernels.compilation import kernel
from skd_sim.world.state import BoolArray, FloatArray, Pair, Triple

from skd_adversary.car_models.observations import Observations

FEATURES: Final = (
    "gap", "lateral", "sideways before", "receding before", "sideways", "receding", "speed", "change", "change before",
    "time to arrival", "lateral at arrival", "closing speed", "time to arrival before", "lateral at arrival before",
    "offset", "turned",
)  # fmt: skip
"""What a split may ask; *before* is of the tick before, times are cut at 8 s, a change is of the car's speed. Of a
car that evades alone: offset and heading at the beginning, to the right of its lane."""
TICK: Final = ("gap", "lateral", "sideways", "receding", "speed", "change", "residual", "offset", "drift", "turned")
"""What is kept of a tick: SI units; `residual` is how far the car drove beyond the mean of its two speeds, m.
Of a car that evades alone: its offset, how that changes, and the heading that it comes to."""

GRID: Final = 128.0
"""Places (m) and speeds (m/s) are resolved to one part in this many: 8 mm."""
FINE: Final = 1024.0
"""The same of all others."""
_PARTS: Final = np.array([GRID] * 5 + [FINE] * 2 + [GRID] + [FINE] * 2)
_LONGEST: Final = 8.0  # s
_WIDEST: Final = 30.0  # m

Array = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]


class Trees(NamedTuple):
    """A forest as kernels use it; one row per node, and one per donor, leaf by leaf and tree by tree.

    Attributes:
        roots: node of each tree's root.
        nodes: feature (−1: a leaf), then of a split: threshold, node where the feature is above it, 0; the other one
            comes right behind the split. Of a leaf: its first donor, how many there are, the medians of their changes,
            drifts and headings.
        donors: change of speed (m/s), residual and drift (m), heading (rad).
    """

    roots: npt.NDArray[np.int64]
    nodes: npt.NDArray[np.float32]
    donors: npt.NDArray[np.float32]


@dataclass(frozen=True)
class CarForest:
    """The forest of a car, as bytes that can be kept and sent.

    Attributes:
        packed: bytes that `pack` has made.
    """

    packed: bytes

    @property
    def trees(self) -> Trees:
        """What is in it.

        Raises:
            UsageError: it is no forest of `pack`.
        """
        return unpacked(self.packed)

    @property
    def evades(self) -> bool:
        """Whether the car goes aside."""
        return bool(self.trees.donors[:, 2:].any())


@kernel
def features_of(
    gap: float, lateral: float, before: Pair, now: Pair, speed: float, changes: Triple, offset: float
) -> tuple[float, ...]:
    """Return the features of a tick, in the order of `FEATURES`.

    Args:
        gap: front bumper to the road user's centre along the lane, m.
        lateral: the road user to the right of the car's middle, m.
        before: the road user's velocity in the last tick, (across the lane, along it away from the car), m/s.
        now: the same in this tick, which a car that decides within a tick sees.
        speed: speed of the car, m/s.
        changes: by how much the car's speed changed in the last tick, and in the tick before that, m/s, and its
            heading now, rad to the right.
        offset: of the car to the right of the lane's middle, m.
    """
    ahead = max(gap, 0.0)
    closing = speed - now[1]
    arrival = _LONGEST if ahead >= _LONGEST * closing else ahead / closing
    there = min(_WIDEST, max(-_WIDEST, lateral + now[0] * arrival))
    closing_before = speed - before[1]
    arrival_before = _LONGEST if ahead >= _LONGEST * closing_before else ahead / closing_before
    there_before = min(_WIDEST, max(-_WIDEST, lateral + before[0] * arrival_before))
    moved = (gap, lateral, before[0], before[1], now[0], now[1], speed, changes[0], changes[1])
    arrives = (arrival, there, closing, arrival_before, there_before)
    return moved + arrives + (offset, changes[2])


@kernel
def leaf_of(nodes: Array, root: int, features: Any) -> int:
    """Return the leaf (its node) to which a tick's features go down a tree."""
    node = root
    while nodes[node, 0] >= 0.0:
        if features[int(nodes[node, 0])] <= nodes[node, 1]:
            node += 1
        else:
            node = int(nodes[node, 2])
    return node


@kernel
def tick_features(ticks: Floats, lengths: npt.NDArray[np.int64], found: Floats) -> None:
    """Write the features of recorded ticks, of episodes one after the other: n × 16 of n × 10, see `TICK`."""
    row = 0
    for episode in range(lengths.shape[0]):
        before, changes = (0.0, 0.0), (0.0, 0.0, 0.0)
        for _ in range(lengths[episode]):
            now = (ticks[row, 2], ticks[row, 3])
            values = features_of(ticks[row, 0], ticks[row, 1], before, now, ticks[row, 4], changes, ticks[row, 7])
            for index in range(len(values)):
                found[row, index] = values[index]
            before, changes = now, (ticks[row, 5], changes[0], ticks[row, 9])
            row += 1


@kernel
def _leaves(nodes: Array, root: int, features: Floats, found: npt.NDArray[np.int64]) -> None:
    for row in range(features.shape[0]):
        found[row] = leaf_of(nodes, root, features[row])


def gridded(ticks: Floats) -> npt.NDArray[np.int16]:
    """Return ticks (n × 7 or n × 10) as they are kept: whole numbers of parts."""
    kept: npt.NDArray[np.int16] = np.clip(np.rint(ticks * _PARTS[: ticks.shape[1]]), -32767, 32767).astype(np.int16)
    return kept


def from_grid(kept: npt.NDArray[np.int16]) -> Floats:
    """Return the ticks that are kept, n × 10; the inverse of `gridded`, but for the rounding."""
    ticks = np.zeros((len(kept), len(TICK)))
    ticks[:, : kept.shape[1]] = kept / _PARTS[: kept.shape[1]]
    return ticks


def pack(
    features: npt.NDArray[np.int8],
    thresholds: npt.NDArray[np.int16],
    sizes: npt.NDArray[np.uint32],
    ticks: npt.NDArray[np.int16],
    lengths: npt.NDArray[np.uint16],
) -> CarForest:
    """Return a forest.

    Args:
        features: number of the feature at each node, tree by tree, every split before what is below it, first the
            branch of values that are not above; −1: a leaf.
        thresholds: thresholds of the splits, in parts of `GRID`: values of at most this, and a half, go the first way.
        sizes: nodes per tree.
        ticks: see `gridded`.
        lengths: ticks per episode.
    """
    # Column by column, and differences: neighbouring ticks are alike.
    columns = np.diff(ticks.astype(np.int32), axis=0, prepend=0).astype(np.int16).T
    file = io.BytesIO()
    np.savez_compressed(file, features=features, thresholds=thresholds, sizes=sizes, ticks=columns, lengths=lengths)
    return CarForest(file.getvalue())


@functools.lru_cache(maxsize=8)
def unpacked(packed: bytes) -> Trees:
    """Return what is in a forest's bytes.

    Raises:
        UsageError: they are none of `pack`.
    """
    try:
        with np.load(io.BytesIO(packed)) as file:
            features, thresholds, sizes, columns, lengths = (
                file[name] for name in ("features", "thresholds", "sizes", "ticks", "lengths")
            )
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error) as error:
        raise UsageError("forest of the car model: not as skd fit writes it") from error
    kept = np.cumsum(columns, axis=1, dtype=np.int16).T
    ticks = from_grid(kept)
    nodes = np.zeros((len(features), 6), dtype=np.float32)
    nodes[:, 0] = features
    nodes[features >= 0, 1] = (thresholds.astype(np.float64) + 0.5) / GRID
    _join(nodes, sizes.astype(np.int64))
    described = np.empty((len(ticks), len(FEATURES)))
    tick_features(ticks, lengths.astype(np.int64), described)
    roots = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
    found = np.empty(len(ticks), dtype=np.int64)
    donors = np.empty((len(sizes) * len(ticks), 4), dtype=np.float32)
    for tree, root in enumerate(roots.tolist()):
        _leaves(nodes, root, described, found)
        order = np.argsort(found, kind="stable")
        begin = tree * len(ticks)
        donors[begin : begin + len(ticks)] = ticks[order][:, [5, 6, 8, 9]]
        leaves, first, counts = np.unique(found[order], return_index=True, return_counts=True)
        nodes[leaves, 1], nodes[leaves, 2] = begin + first, counts
        for column, node in ((5, 3), (8, 4), (9, 5)):
            by_size = np.lexsort((ticks[order, column], found[order]))
            nodes[leaves, node] = ticks[order, column][by_size][first + counts // 2]
    return Trees(roots, nodes, donors)


def _join(nodes: Array, sizes: npt.NDArray[np.int64]) -> None:
    """Write where each split's second way leads; nodes stand depth first."""
    begin = 0
    for size in sizes.tolist():
        waiting: list[int] = []  # splits whose second way has not begun
        for node in range(begin, begin + size):
            if nodes[node, 0] >= 0.0:
                waiting.append(node)
            elif waiting:
                nodes[waiting.pop(), 2] = node + 1
        begin += size


TREES: Final = 40
LEAST_DONORS: Final = 5
"""In a leaf."""


def kept_ticks(data: Observations) -> npt.NDArray[np.int16]:
    """Return the ticks as a forest keeps them."""
    columns = (
        data.gap,
        data.lateral,
        data.walking_sideways,
        data.walking_away,
        data.speed,
        data.speed_after - data.speed,
        data.travelled - 0.5 * data.time_step * (data.speed + data.speed_after),
        *((data.offset, data.drift, data.turned) if data.evades else ()),
    )
    return gridded(np.column_stack(columns))


def lengths_of(data: Observations) -> npt.NDArray[np.int64]:
    """Return the number of ticks of each episode."""
    begins = np.flatnonzero(data.tick == 0)
    return np.diff(np.append(begins, len(data))).astype(np.int64)


def described(data: Observations) -> tuple[FloatArray, FloatArray]:
    """Return features (n × 14; n × 16 of a car that evades) and what to predict of ticks, as a forest sees them.

    That is the change of speed, m/s, and of a car that evades drift (m) and heading (rad), too: n, or n × 3.
    """
    ticks = from_grid(kept_ticks(data))
    features = np.empty((len(ticks), len(FEATURES)))
    tick_features(ticks, lengths_of(data), features)
    if not data.evades:
        return features[:, :-2], ticks[:, 5]
    return features, ticks[:, [5, 8, 9]]


def grow(data: Observations, *, seed: int = 0) -> CarForest:
    """Return the forest of some ticks; the same ticks always give the same forest.

    Args:
        data: ticks of whole episodes.
        seed: seed of the random draws.
    """
    from sklearn.ensemble import RandomForestRegressor  # slow to import, and needed only now

    features, found = described(data)
    whole = np.ceil(features * GRID - 0.5)  # what is resolved; halves go down, as in `leaf_of`
    forest = RandomForestRegressor(TREES, min_samples_leaf=LEAST_DONORS, random_state=seed, n_jobs=-1)
    forest.fit(whole.astype(np.float32), found / found.std(axis=0) if data.evades else found)
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
    )


@kernel
def _positions(
    roots: Any, nodes: Any, donors: Any, features: FloatArray, change: FloatArray, below: FloatArray, equal: FloatArray
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
