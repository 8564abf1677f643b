"""A car as a forest of regression trees: what it did in the recorded ticks that were most like the present one.

There is no law in it. A tick's features go down a tree to a leaf, where some recorded ticks lie, the *donors*; what the
car did in one of them is what it is thought to do (quantile regression forests, Meinshausen 2006). A file holds the
trees' splits and the recorded ticks; which donors lie where follows.
"""

from __future__ import annotations

import functools
import struct
import zlib
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from skd_sim.errors import UsageError
from skd_sim.kernels.compilation import kernel

FEATURES: Final = (
    "gap", "lateral", "sideways before", "receding before", "sideways", "receding", "speed", "change", "change before",
    "time to arrival", "lateral at arrival", "closing speed", "time to arrival before", "lateral at arrival before",
)  # fmt: skip
"""What a split may ask; *before* is of the tick before, times are cut at 8 s, and a change is of the car's speed."""
TICK: Final = ("gap", "lateral", "sideways", "receding", "speed", "change", "residual")
"""What is kept of a tick: SI units; `residual` is the way that the car made beyond the mean of its two speeds, m."""

GRID: Final = 128.0
"""Places (m) and speeds (m/s) are told apart to one part in this many: 8 mm."""
FINE: Final = 1024.0
"""The same of changes of speed and residuals."""
_LONGEST: Final = 8.0  # s
_WIDEST: Final = 30.0  # m
_MAGIC: Final = b"SKDF1\0"
_HEAD: Final = struct.Struct("<6sddIIII")
_LARGEST: Final = 64 * 2**20  # bytes unpacked
_MOST_TREES: Final = 1000

Array = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]


class Trees(NamedTuple):
    """A forest as kernels use it; one row per node, and one per donor, leaf by leaf and tree by tree.

    Attributes:
        roots: node of each tree's root.
        nodes: feature (−1: a leaf), then of a split: threshold, node where the feature is above it, 0; the other one
            comes right behind the split. Of a leaf: its first donor, how many there are, the median of their changes.
        donors: change of speed (m/s) and residual (m).
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


@kernel
def features_of(
    gap: float,
    lateral: float,
    sideways_before: float,
    receding_before: float,
    sideways: float,
    receding: float,
    speed: float,
    change: float,
    change_before: float,
) -> tuple[
    float, float, float, float, float, float, float, float, float, float, float, float, float, float
]:  # fmt: skip
    """Return the features of a tick, in the order of `FEATURES`.

    Args:
        gap: front bumper to the road user's centre along the lane, m.
        lateral: offset of the road user to the right of the centre line, m.
        sideways_before: the road user's velocity across the lane in the last tick, m/s.
        receding_before: the road user's velocity along the lane in the last tick, away from the car, m/s.
        sideways: the road user's velocity across the lane in this tick, which a car that decides within a tick sees,
            m/s.
        receding: the road user's velocity along the lane in this tick, away from the car, m/s.
        speed: speed of the car, m/s.
        change: change of the car's speed in the last tick, m/s.
        change_before: change of the car's speed in the tick before that, m/s.
    """
    closing = speed - receding
    ahead = max(gap, 0.0)
    arrival = _LONGEST if ahead >= _LONGEST * closing else ahead / closing
    there = min(_WIDEST, max(-_WIDEST, lateral + sideways * arrival))
    closing_before = speed - receding_before
    arrival_before = _LONGEST if ahead >= _LONGEST * closing_before else ahead / closing_before
    there_before = min(_WIDEST, max(-_WIDEST, lateral + sideways_before * arrival_before))
    return (
        gap,
        lateral,
        sideways_before,
        receding_before,
        sideways,
        receding,
        speed,
        change,
        change_before,
        arrival,
        there,
        closing,
        arrival_before,
        there_before,
    )  # fmt: skip


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
    """Write the features of recorded ticks, of episodes one after the other: n × 14 of n × 7, see `TICK`."""
    row = 0
    for episode in range(lengths.shape[0]):
        sideways_before, receding_before, change, change_before = 0.0, 0.0, 0.0, 0.0
        for _ in range(lengths[episode]):
            values = features_of(
                ticks[row, 0],
                ticks[row, 1],
                sideways_before,
                receding_before,
                ticks[row, 2],
                ticks[row, 3],
                ticks[row, 4],
                change,
                change_before,
            )
            for index in range(len(values)):
                found[row, index] = values[index]
            sideways_before, receding_before = ticks[row, 2], ticks[row, 3]
            change_before = change
            change = ticks[row, 5]
            row += 1


@kernel
def _leaves(nodes: Array, root: int, features: Floats, found: npt.NDArray[np.int64]) -> None:
    for row in range(features.shape[0]):
        found[row] = leaf_of(nodes, root, features[row])


def gridded(ticks: Floats) -> npt.NDArray[np.int16]:
    """Return ticks (n × 7) as they are kept: whole numbers of parts."""
    parts = np.array([GRID] * 5 + [FINE] * 2)
    kept: npt.NDArray[np.int16] = np.clip(np.rint(ticks * parts), -32767, 32767).astype(np.int16)
    return kept


def from_grid(kept: npt.NDArray[np.int16]) -> Floats:
    """Return the ticks that are kept; the inverse of `gridded`, but for the rounding."""
    return np.asarray(kept / np.array([GRID] * 5 + [FINE] * 2))


def pack(
    features: npt.NDArray[np.int8],
    thresholds: npt.NDArray[np.int16],
    sizes: npt.NDArray[np.uint32],
    ticks: npt.NDArray[np.int16],
    lengths: npt.NDArray[np.uint16],
    *,
    time_step: float,
    car_length: float,
) -> CarForest:
    """Return a forest.

    Args:
        features: number of the feature at each node, tree by tree, every split before what is below it, first the
            branch of values that are not above; −1: a leaf.
        thresholds: thresholds of the splits, in parts of `GRID`: values of at most this, and a half, go the first way.
        sizes: nodes per tree.
        ticks: n × 7, see `gridded`.
        lengths: ticks per episode.
        time_step: duration of a tick, s.
        car_length: length of the car, m.
    """
    head = _HEAD.pack(_MAGIC, time_step, car_length, len(sizes), len(features), len(ticks), len(lengths))
    arrays = (sizes.astype("<u4"), features.astype("i1"), thresholds.astype("<i2"), lengths.astype("<u2"))
    # Column by column, and differences: neighbouring ticks are alike.
    columns = np.diff(ticks.astype(np.int32), axis=0, prepend=0).astype("<i2").T
    return CarForest(zlib.compress(head + b"".join(one.tobytes() for one in arrays) + columns.tobytes(), 9))


@functools.lru_cache(maxsize=8)
def unpacked(packed: bytes) -> Trees:
    """Return what is in a forest's bytes.

    Raises:
        UsageError: they are none of `pack`.
    """
    ticks, lengths, features, thresholds, sizes, _ = _read(packed)
    nodes = np.zeros((len(features), 4), dtype=np.float32)
    nodes[:, 0] = features
    nodes[features >= 0, 1] = (thresholds + 0.5) / GRID
    _join(nodes, sizes)
    described = np.empty((len(ticks), len(FEATURES)))
    tick_features(ticks, lengths, described)
    roots = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
    found = np.empty(len(ticks), dtype=np.int64)
    donors = np.empty((len(sizes) * len(ticks), 2), dtype=np.float32)
    for tree, root in enumerate(roots.tolist()):
        _leaves(nodes, root, described, found)
        order = np.argsort(found, kind="stable")
        begin = tree * len(ticks)
        donors[begin : begin + len(ticks)] = ticks[order, 5:]
        leaves, first, counts = np.unique(found[order], return_index=True, return_counts=True)
        nodes[leaves, 1], nodes[leaves, 2] = begin + first, counts
        by_change = np.lexsort((ticks[order, 5], found[order]))
        nodes[leaves, 3] = ticks[order, 5][by_change][first + counts // 2]
    if (nodes[features < 0, 2] < 1).any():
        raise UsageError("forest of the car model: no tick lies in one of its leaves")
    return Trees(roots, nodes, donors)


def _read(
    packed: bytes,
) -> tuple[Floats, npt.NDArray[np.int64], npt.NDArray[np.int8], Array, npt.NDArray[np.int64], tuple[float, float]]:
    """Return ticks, ticks per episode, features, thresholds, nodes per tree, and (time step, length of the car)."""
    wrong = UsageError("forest of the car model: not as skd fit writes it")
    try:
        unpacking = zlib.decompressobj()
        data = unpacking.decompress(packed, _LARGEST)
        magic, time_step, car_length, trees, count, rows, episodes = _HEAD.unpack_from(data)
    except (zlib.error, struct.error) as error:
        raise wrong from error
    splits = (count - trees) // 2  # of binary trees
    counts = {"<u4": trees, "i1": count, "<i2": splits, "<u2": episodes}
    whole = _HEAD.size + sum(np.dtype(kind).itemsize * size for kind, size in counts.items()) + 2 * len(TICK) * rows
    few = 1 <= trees <= _MOST_TREES and trees <= count and rows >= 1
    if magic != _MAGIC or not unpacking.eof or len(data) != whole or not few or 480 * count * 4 > 64 * _LARGEST:
        raise wrong
    place, parts = _HEAD.size, []
    for kind, size in counts.items():
        parts.append(np.frombuffer(data, kind, size, place))
        place += np.dtype(kind).itemsize * size
    sizes, features, thresholds, lengths = parts
    kept = np.cumsum(np.frombuffer(data, "<i2", -1, place).reshape(len(TICK), rows), axis=1, dtype=np.int16).T
    if (
        int(sizes.sum()) != count
        or int(lengths.sum()) != rows
        or int((features >= 0).sum()) != splits
        or features.size == 0
        or features.min() < -1
        or features.max() >= len(FEATURES)
        or trees * rows > 2**24
        or count > 2**24
    ):
        raise wrong
    return (
        from_grid(kept),
        lengths.astype(np.int64),
        features.astype(np.int8),
        thresholds.astype(np.float64),
        sizes.astype(np.int64),
        (float(time_step), float(car_length)),
    )


def _join(nodes: Array, sizes: npt.NDArray[np.int64]) -> None:
    """Write where each split's second way leads; nodes stand depth first.

    Raises:
        UsageError: they are no trees.
    """
    begin = 0
    for size in sizes.tolist():
        waiting: list[int] = []  # splits whose second way has not begun
        complete = size == 0
        for node in range(begin, begin + size):
            if complete:
                break
            if nodes[node, 0] >= 0.0:
                waiting.append(node)
            elif waiting:
                nodes[waiting.pop(), 2] = node + 1
            else:
                complete = node == begin + size - 1
                if not complete:
                    raise UsageError("forest of the car model: its trees do not end")
        if not complete or size == 0:
            raise UsageError("forest of the car model: its trees do not end")
        begin += size
