"""Frames of /tf and /tf_static (REP 105): where each lies in its parent over time, and so in any other frame."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation, Slerp
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError

_DEEPEST = 30  # frames above each other
_HELD = 0.5  # s that a transform holds before its first and after its last stamp


class Poses(NamedTuple):
    """Poses of one frame in another at some times: places (n × 3, m) and n rotations."""

    places: FloatArray
    turns: Rotation

    @property
    def headings(self) -> FloatArray:
        """Where their x axes point, seen from above, n, rad."""
        turned = self.turns.as_matrix()
        return np.asarray(np.arctan2(turned[:, 1, 0], turned[:, 0, 0]))

    def on(self, below: Poses) -> Poses:
        """Return the poses, in this frame's own parent, of a frame that lies in this one."""
        return Poses(self.places + self.turns.apply(below.places), self.turns * below.turns)

    @property
    def inverse(self) -> Poses:
        """The poses of the parent in this frame."""
        back = self.turns.inv()
        return Poses(-back.apply(self.places), back)


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
            UsageError: the frame has another parent already, or the numbers are no transform.
        """
        if self._parents.setdefault(child, parent) != parent:
            raise UsageError(
                f"{self._where}: frame {child!r} lies in {self._parents[child]!r} and in {parent!r}: two trees"
            )
        if not all(map(math.isfinite, row)) or abs(math.hypot(*row[4:]) - 1.0) > 0.01:
            raise UsageError(f"{self._where}: frame {child!r} has a transform that is none")
        self._rows.setdefault(child, []).append(row)
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
        """Return the highest frame above one."""
        return self._above(frame)[-1]

    def stamps(self, frame: str) -> FloatArray:
        """Return the times at which a frame, or else the next moving one above it, has a transform, s.

        Raises:
            UsageError: all of them are static.
        """
        for one in self._above(frame)[:-1]:
            if one not in self._static:
                return self._table(one)[:, 0]
        raise UsageError(f"{self._where}: frame {frame!r} does not move: all above it is fixed")

    def poses(self, frame: str, within: str, times: FloatArray) -> Poses:
        """Return where a frame lies in another at some times (s).

        Raises:
            UsageError: they are in two trees, or a transform is not known at one of these times.
        """
        if self.root(frame) != self.root(within):
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
        found = Poses(np.zeros((len(times), 3)), Rotation.identity(len(times)))
        for one in self._above(frame)[:-1]:
            found = self._at(one, times).on(found)
        return found

    def _table(self, frame: str) -> FloatArray:
        """Return the rows of a frame by time, the last of each time."""
        return np.array(sorted({row[0]: row for row in self._rows[frame]}.values()), np.float64)

    def _at(self, frame: str, times: FloatArray) -> Poses:
        rows, is_static = self._table(frame), frame in self._static
        if not is_static and (times[0] < rows[0, 0] - _HELD or times[-1] > rows[-1, 0] + _HELD):
            raise UsageError(
                f"{self._where}: frame {frame!r} has transforms from {rows[0, 0]:.2f} to {rows[-1, 0]:.2f} s, none at "
                f"{times[0]:.2f} to {times[-1]:.2f} s"
            )
        if is_static or len(rows) == 1:
            same = np.tile(rows[-1], (len(times), 1))
            return Poses(same[:, 1:4], Rotation.from_quat(same[:, 4:]))
        held = np.clip(times, rows[0, 0], rows[-1, 0])
        places = np.column_stack([np.interp(held, rows[:, 0], column) for column in rows[:, 1:4].T])
        return Poses(places, Slerp(rows[:, 0], Rotation.from_quat(rows[:, 4:]))(held))
