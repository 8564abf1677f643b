"""Frames of /tf and /tf_static (REP 105): where one lies in another, by the rules of tf2.

Each frame has samples of its own, each with its parent, so a frame may be attached elsewhere later. Between two samples
of one parent places go in straight lines and turns by the shortest way, and so for less than one usual step before the
first and after the last; nothing is said beyond, or in a hole. Only frames between the two requested are looked
at. A transform that is no transform is dropped, as tf2 does. Times are whole nanoseconds, so the same recording at
another time gives the same numbers.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from skd_sim.errors import UsageError
from skd_sim.world.state import BoolArray, FloatArray, IntArray

_DEEPEST = 30  # frames above each other
_SAME = 1e-3  # m, and rad, by which two fixed transforms may differ
_UNIT = 0.01  # by which the length of a quaternion may be off 1, as in tf2
_LEAP, _OFTEN = 0.05, 0.2  # m to and fro in a fifth of all samples: no single node publishes so
_BRAKES = 12.0  # m/s², more than tyres give
SECOND = 1e9  # ns


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


class At(NamedTuple):
    """When something is requested, n each, ns: by the stamps, and by the recorder, which fixed frames go by."""

    stamps: IntArray
    logged: IntArray

    def some(self, rows: IntArray) -> At:
        """Return those with some indices."""
        return At(self.stamps[rows], self.logged[rows])


@dataclass
class _Samples:
    """What was said of where one frame lies.

    Attributes:
        moving: stamp and recorder's time (ns), parent, and x, y, z (m) with the quaternion x, y, z, w.
        fixed: the same of /tf_static.
    """

    moving: list[tuple[int, int, str, tuple[float, ...]]] = field(default_factory=list)
    fixed: list[tuple[int, int, str, tuple[float, ...]]] = field(default_factory=list)
    dropped: int = 0

    @property
    def parents(self) -> list[str]:
        """Every frame in which it lies at some time."""
        return list(dict.fromkeys(one[2] for one in (*self.fixed, *self.moving)))


class Transforms:
    """Frames with their parents; filled message by message."""

    def __init__(self, where: str, longest_gap: float) -> None:
        """Begin without any frame.

        Args:
            where: the recording, for messages.
            longest_gap: time between two samples, s, beyond which nothing is said between them.
        """
        self._notes: dict[str, None] = {}
        self._where, self._longest = where, round(SECOND * longest_gap)
        self._samples: dict[str, _Samples] = {}

    def add(self, parent: str, child: str, stamp: int, logged: int, row: tuple[float, ...], *, fixed: bool) -> None:
        """Add where a frame lies in its parent.

        Args:
            parent: name of the parent; a leading slash counts for nothing.
            child: name of the frame.
            stamp: when it lies there, ns.
            logged: when that was recorded, ns.
            row: x, y, z, m; quaternion x, y, z, w.
            fixed: whether it lies so from then on.
        """
        known = self._samples.setdefault(bare(child), _Samples())
        if not all(map(math.isfinite, row)) or abs(math.hypot(*row[3:]) - 1.0) > _UNIT or bare(parent) == bare(child):
            known.dropped += 1
        else:
            (known.fixed if fixed else known.moving).append((stamp, logged, bare(parent), row))

    @property
    def frames(self) -> list[str]:
        """Names of all frames, in the order in which they were first said."""
        return list(dict.fromkeys(one for child, said in self._samples.items() for one in (*said.parents, child)))

    def summary(self) -> Iterator[tuple[str, str, bool, FloatArray]]:
        """Yield each frame that lies in another: its name, its parents, whether it moves, and its stamps, s."""
        for child, said in self._samples.items():
            stamps = sorted({one[0] for one in said.moving or said.fixed})
            yield child, ", ".join(said.parents), bool(said.moving), np.array(stamps, np.float64) / SECOND

    def root(self, frame: str) -> str:
        """Return the highest frame above one."""
        return self._above(frame)[-1]

    def times(self, frame: str, within: str) -> At:
        """Return when a frame, or else the next moving one on the way to another, is said to lie somewhere.

        Raises:
            UsageError: all of them are fixed, or nothing joins the two.
        """
        common = self._common(frame, within)
        for end in (frame, within):
            for one in self._above(end):
                if one == common:
                    break
                said = self._samples[one]
                if said.moving and not said.fixed:
                    found = {stamp: logged for stamp, logged, _, _ in sorted(said.moving, key=lambda each: each[1])}
                    stamps = np.array(sorted(found), np.int64)
                    return At(stamps, np.array([found[stamp] for stamp in stamps.tolist()], np.int64))
        raise UsageError(f"{self._where}: frame {frame!r} does not move in {within!r}: all between them is fixed")

    def moved(self, rows: FloatArray, frame: str, within: str, at: At) -> tuple[FloatArray, BoolArray, list[str]]:
        """Return places that are said in one frame in another, where that is known, and what is to be said of it.

        Args:
            rows: n × 4, x, y, z (m) and heading (rad; nan: none).
            frame: in which they are.
            within: in which they are requested.
            at: when they are there.

        Raises:
            UsageError: nothing joins the two, or what joins them is said in two ways.
        """
        self._notes.clear()
        common = self._common(frame, within)
        below, known = self._up(frame, common, at)
        above, also = self._up(within, common, at)
        turns = Rotation.from_rotvec(np.outer(np.nan_to_num(rows[:, 3]), [0.0, 0.0, 1.0]))
        found = above.inverse.on(below).on(Poses(rows[:, :3], turns))
        headings = np.where(np.isnan(rows[:, 3]), np.nan, found.headings)
        return np.column_stack([found.places, headings]), known & also, list(self._notes)

    def _above(self, frame: str) -> list[str]:
        """Return a frame and those above it, nearest first."""
        found = [frame]
        for one in found:
            found += [up for up in (self._samples[one].parents if one in self._samples else ()) if up not in found]
        return found

    def _common(self, frame: str, within: str) -> str:
        above = self._above(within)
        common = next((one for one in self._above(frame) if one in above), None)
        if common is None or not {frame, within} <= {*self.frames, common}:
            raise UsageError(f"{self._where}: nothing says how {frame!r} lies in {within!r}")
        return common

    def _up(self, frame: str, top: str, at: At, depth: int = 0) -> tuple[Poses, BoolArray]:
        """Return where a frame lies in one above it, and when that is known."""
        count = len(at.stamps)
        places, turns, known = np.zeros((count, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)), np.zeros(count, bool)
        if frame == top:
            return Poses(places, Rotation.from_quat(turns)), ~known
        if depth > _DEEPEST:
            raise UsageError(f"{self._where}: frames lie in each other in a circle, or in more than {_DEEPEST}")
        for parent in self._samples[frame].parents if frame in self._samples else ():
            rows, here = self._sampled(frame, parent, at)
            if rows.size:
                above, also = self._up(parent, top, at.some(rows), depth + 1)
                found = above.on(here)
                places[rows], turns[rows], known[rows] = found.places, found.turns.as_quat(), also
        return Poses(places, Rotation.from_quat(turns)), known

    def _sampled(self, frame: str, parent: str, at: At) -> tuple[IntArray, Poses]:
        """Return at which times (as indices) a frame is known to lie in a parent, and where it lies then."""
        said = self._samples[frame]
        if said.dropped:
            self._notes[f"{said.dropped} transforms of {frame!r} are no finite numbers or no turns: left out"] = None
        if said.fixed:
            return self._fixed(frame, parent, at)
        by_stamp = {one[0]: one for one in sorted(said.moving, key=lambda each: each[1])}
        samples = [by_stamp[stamp] for stamp in sorted(by_stamp)]
        stamps, rows = np.array([one[0] for one in samples], np.int64), np.array([one[3] for one in samples])
        ours = np.array([one[2] == parent for one in samples])
        self._refuse_two(frame, stamps, rows[:, :3], ours)
        before = np.clip(np.searchsorted(stamps, at.stamps, side="right") - 1, 0, max(len(stamps) - 2, 0))
        before = np.where(stamps[-1] == at.stamps, len(stamps) - 1, before)
        exact = stamps[before] == at.stamps
        after = np.where(exact, before, np.minimum(before + 1, len(stamps) - 1))
        step = stamps[after] - stamps[before]
        usual = min(int(np.median(np.diff(stamps))), self._longest) if len(stamps) > 1 else 0
        inside = exact | ((at.stamps > stamps[0] - usual) & (at.stamps < stamps[-1] + usual))
        outside, is_hole = at.stamps[~inside], step > self._longest
        holes = [(outside[0], stamps[0])] if outside.size and outside[0] < stamps[0] else []
        holes += [(stamps[one], stamps[one + 1]) for one in np.unique(before[inside & is_hole]).tolist()]
        holes += [(stamps[-1], outside[-1])] if outside.size and outside[-1] > stamps[-1] else []
        for begin, end in holes:
            span = f"from {begin / SECOND:.2f} to {end / SECOND:.2f} s"
            self._notes[f"nothing says how {frame!r} lies in {parent!r} {span}"] = None
        known = np.flatnonzero(inside & ~is_hole & ours[before] & ours[after])
        first, last = rows[before[known]], rows[after[known]]
        share = ((at.stamps[known] - stamps[before[known]]) / np.maximum(step[known], 1))[:, None]
        turns = Rotation.from_quat(first[:, 3:])
        turned = turns * Rotation.from_rotvec(share * (turns.inv() * Rotation.from_quat(last[:, 3:])).as_rotvec())
        return known, Poses(first[:, :3] + share * (last[:, :3] - first[:, :3]), turned)

    def _fixed(self, frame: str, parent: str, at: At) -> tuple[IntArray, Poses]:
        """Return the same of a fixed frame: as it was last said to lie when that was recorded, from the first on."""
        said = self._samples[frame]
        samples = sorted(said.fixed, key=lambda each: each[1])
        if any(_apart(one[3], samples[0][3]) > _SAME or one[2] != samples[0][2] for one in said.moving):
            raise UsageError(f"{self._where}: frame {frame!r} is said to be fixed (/tf_static) and to move (/tf)")
        apart, second = max(((_apart(one[3], samples[0][3]), one[1]) for one in samples), key=lambda each: each[0])
        if apart > _SAME:
            ways = (
                f"in two ways in {parent!r}, {apart:.3g} m or rad apart (the second at {second / SECOND:.2f} s by the"
            )
            self._notes[f"fixed frame {frame!r} is said to lie {ways} recorder): each counts from when it was said"] = (
                None
            )
        logged, rows = np.array([one[1] for one in samples], np.int64), np.array([one[3] for one in samples])
        chosen = np.maximum(np.searchsorted(logged, at.logged, side="right") - 1, 0)
        known = np.flatnonzero(np.array([one[2] == parent for one in samples])[chosen])
        found = rows[chosen[known]].reshape(-1, 7)
        return known, Poses(found[:, :3], Rotation.from_quat(found[:, 3:]))

    def _refuse_two(self, frame: str, stamps: IntArray, places: FloatArray, ours: BoolArray) -> None:
        """Refuse a frame that leaps to and fro, or is in two places at once: two nodes publish it."""
        said: dict[tuple[int, str], tuple[float, ...]] = {}
        twice = [
            math.dist(said.setdefault((stamp, parent), row)[:3], row[:3])
            for stamp, _, parent, row in self._samples[frame].moving
        ]
        off = zigzag((stamps[ours] - stamps[0]) / SECOND, places[ours])
        leaps = np.append(off[off > _LEAP], [one for one in twice if one > _LEAP])
        if len(leaps) > _OFTEN * len(stamps) and len(stamps) >= 5:
            how = f"by {np.median(leaps):.2g} m ({len(leaps)} of {len(twice)} transforms)"
            raise UsageError(f"{self._where}: frame {frame!r} leaps to and fro {how}: do two nodes publish it?")


def bare(frame: str) -> str:
    """Return the name of a frame as tf2 has it: without a leading slash."""
    return frame.lstrip("/")


def zigzag(times: FloatArray, places: FloatArray) -> FloatArray:
    """Return how far each place but the ends is off the line between its neighbours, beyond what brakes do, m.

    Args:
        times: n, s, increasing.
        places: n × 2 or n × 3, m.
    """
    if len(times) < 3:
        return np.zeros(0)
    lasting = times[2:] - times[:-2]
    share = ((times[1:-1] - times[:-2]) / lasting)[:, None]
    off = np.linalg.norm(places[1:-1] - (1.0 - share) * places[:-2] - share * places[2:], axis=1)
    return np.asarray(off - 0.125 * _BRAKES * lasting**2)


def _apart(one: tuple[float, ...], other: tuple[float, ...]) -> float:
    """Return how far two transforms are apart: the larger of m and rad."""
    turned = 2.0 * math.acos(min(1.0, abs(sum(a * b for a, b in zip(one[3:], other[3:], strict=True)))))
    return max(math.dist(one[:3], other[:3]), turned)
