"""Where frames lie in each other over time, as /tf and /tf_static of a recording say (REP 105)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError

_DEEPEST = 30  # frames above each other
_HELD = 0.5  # s that a transform holds before its first and after its last stamp


class Poses(NamedTuple):
    """Poses of one frame in another at some times.

    Attributes:
        places: n × 3, m.
        turns: n × 4, unit quaternions (x, y, z, w).
    """

    places: FloatArray
    turns: FloatArray

    @property
    def headings(self) -> FloatArray:
        """Where their x axes point, seen from above, n, rad."""
        x, y, z, w = self.turns.T
        return np.asarray(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y**2 + z**2)))

    def on(self, below: Poses) -> Poses:
        """Return the poses, in this frame's own parent, of a frame that lies in this one."""
        return Poses(self.places + rotated(self.turns, below.places), product(self.turns, below.turns))

    @property
    def inverse(self) -> Poses:
        """The poses of the parent in this frame."""
        back = self.turns * np.array([-1.0, -1.0, -1.0, 1.0])
        return Poses(-rotated(back, self.places), back)


def product(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return products of quaternions (x, y, z, w), n × 4 each."""
    (a, b, c, d), (e, f, g, h) = first.T, second.T
    return np.column_stack([d * e + a * h + b * g - c * f, d * f - a * g + b * h + c * e, d * g + a * f - b * e + c * h,
                            d * h - a * e - b * f - c * g])  # fmt: skip


def rotated(turns: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return vectors (n × 3) turned by unit quaternions (n × 4)."""
    axis, w = turns[:, :3], turns[:, 3:]
    twice = 2.0 * np.cross(axis, vectors)
    return np.asarray(vectors + w * twice + np.cross(axis, twice))


class Transforms:
    """Frames, each with its parent; filled message by message."""

    def __init__(self, where: str) -> None:
        """Begin without any frame; `where` is the recording, for messages."""
        self._where = where
        self._parents: dict[str, str] = {}
        self._rows: dict[str, list[tuple[float, ...]]] = {}
        self._static: set[str] = set()

    def add(self, parent: str, child: str, row: tuple[float, ...], *, static: bool) -> None:
        """Add where a frame lies in its parent.

        Args:
            parent: name of the parent.
            child: name of the frame.
            row: time, s; x, y, z, m; quaternion x, y, z, w.
            static: whether it lies so all the time.

        Raises:
            UsageError: the frame has another parent already, or a number is none.
        """
        if self._parents.setdefault(child, parent) != parent:
            raise UsageError(
                f"{self._where}: frame {child!r} lies in {self._parents[child]!r} and in {parent!r}: two trees"
            )
        length = math.hypot(*row[4:])
        if not all(map(math.isfinite, row)) or abs(length - 1.0) > 0.01:
            raise UsageError(f"{self._where}: frame {child!r} has a transform that is none")
        self._rows.setdefault(child, []).append((*row[:4], *(one / length for one in row[4:])))
        if static:
            self._static.add(child)

    def knows(self, frame: str) -> bool:
        """Return whether a frame is in the tree."""
        return frame in self._parents or frame in self._parents.values()

    @property
    def frames(self) -> list[str]:
        """Names of all frames that lie in another, in the order in which they were first seen."""
        return list(self._parents)

    def root(self, frame: str) -> str:
        """Return the frame above all others that a frame lies in."""
        return self._above(frame)[-1]

    def stamps(self, frame: str) -> FloatArray:
        """Return when it was said where a frame lies, s; of one that is fixed in another, when that is said of it."""
        for one in self._above(frame)[:-1]:
            if one not in self._static:
                return self._table(one)[:, 0]
        raise UsageError(f"{self._where}: frame {frame!r} does not move: all above it is fixed")

    def poses(self, frame: str, within: str, times: FloatArray) -> Poses:
        """Return where a frame lies in another at some times (s).

        Raises:
            UsageError: nothing says so, or not at these times.
        """
        mine, other = self._above(frame), self._above(within)
        if mine[-1] != other[-1]:
            raise UsageError(f"{self._where}: nothing says how {frame!r} lies in {within!r}")
        return self._in_root(within, times).inverse.on(self._in_root(frame, times))

    def _above(self, frame: str) -> list[str]:
        found = [frame]
        while found[-1] in self._parents:
            found.append(self._parents[found[-1]])
            if len(found) > _DEEPEST:
                raise UsageError(f"{self._where}: frames lie in each other in a circle, or in more than {_DEEPEST}")
        return found

    def _in_root(self, frame: str, times: FloatArray) -> Poses:
        count = len(times)
        found = Poses(np.zeros((count, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)))
        for one in self._above(frame)[:-1]:
            found = self._at(one, times).on(found)
        return found

    def _table(self, frame: str) -> FloatArray:
        rows = np.array(self._rows[frame], np.float64)
        rows = rows[np.argsort(rows[:, 0], kind="stable")]
        return np.asarray(rows[np.append(np.diff(rows[:, 0]) > 0.0, True)])

    def _at(self, frame: str, times: FloatArray) -> Poses:
        rows = self._table(frame)
        if frame in self._static:
            return Poses(np.tile(rows[-1, 1:4], (len(times), 1)), np.tile(rows[-1, 4:], (len(times), 1)))
        if times[0] < rows[0, 0] - _HELD or times[-1] > rows[-1, 0] + _HELD:
            raise UsageError(
                f"{self._where}: where {frame!r} lies is said from {rows[0, 0]:.2f} to {rows[-1, 0]:.2f} s, and asked "
                f"for from {times[0]:.2f} to {times[-1]:.2f} s"
            )
        after = np.clip(np.searchsorted(rows[:, 0], times), 1, max(1, len(rows) - 1)) if len(rows) > 1 else None
        if after is None:
            return Poses(np.tile(rows[0, 1:4], (len(times), 1)), np.tile(rows[0, 4:], (len(times), 1)))
        first, second = rows[after - 1], rows[after]
        share = np.clip((times - first[:, 0]) / (second[:, 0] - first[:, 0]), 0.0, 1.0)[:, None]
        # The shorter way round: q and −q are the same turn.
        sign = np.where((first[:, 4:] * second[:, 4:]).sum(axis=1) < 0.0, -1.0, 1.0)[:, None]
        turns = (1.0 - share) * first[:, 4:] + share * sign * second[:, 4:]
        return Poses(
            first[:, 1:4] + share * (second[:, 1:4] - first[:, 1:4]),
            turns / np.linalg.norm(turns, axis=1, keepdims=True),
        )
