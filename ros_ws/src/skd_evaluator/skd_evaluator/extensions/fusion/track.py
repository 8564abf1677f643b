"""Tracked objects: where one was over time, in a recording's own frame, at a rate of its own; and frames (REP 105)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from skd_sim.arrays import FloatArray, IntArray
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


LONGEST_HOLE = 0.5
"""s without a position, above which a track is refused: a car at 50 km/h moves 7 m in it."""
LONGEST = 3600.0
"""s that a track may last: every fiftieth of a second of it is tried as the beginning of a trial."""
FASTEST = 70.0
"""m/s that nobody on a proving ground exceeds between two positions, jumps of a few centimetres left aside."""
_JITTER = 0.3  # m
_MOVES = 1.0  # m/s, from which directions and speeds of positions say something
_SAME_SPEED = 1.3  # ratio of a stated speed to that of the positions from which on they are in different units
_SLACK = 1.0  # m/s by which a stated speed may be off besides: braking within half of _OVER, and noise
_OVER = 0.5  # s over which a speed of positions is taken to check a stated one
_FIT, _FEWEST = 0.3, 3  # s before and after a moment through which lines are laid, and positions that this takes
_BRAKES = 12.0  # m/s², more than tyres give
_FARTHEST = 1e8  # m; UTM's coordinates stay below a tenth of it


@dataclass(frozen=True)
class RecordingFrame:
    """Where the frame `map` of the scenario lies in a recording's frame.

    Attributes:
        x: its origin, m.
        y: its origin, m.
        turned: heading of its x axis (East), rad.
    """

    x: float = 0.0
    y: float = 0.0
    turned: float = 0.0


@dataclass(frozen=True, eq=False)
class Track:
    """One tracked object.

    Attributes:
        times: n, s, strictly increasing.
        places: n × 2, m.
        headings: n, rad; None where the recording does not say.
        speeds: n, m/s; None where the recording does not say.
        where: file and topic or id, for messages.
    """

    times: FloatArray
    places: FloatArray
    headings: FloatArray | None
    speeds: FloatArray | None
    where: str

    def checked(self) -> Track:
        """Return it, once it is looked at.

        Raises:
            UsageError: too few positions, times that do not increase or last too long, numbers that are not finite,
                jumps, or speeds that are not those of the positions.
        """
        if len(self.times) < 5:
            raise UsageError(f"{self.where}: {len(self.times)} positions are no track")
        rows = [self.times, *self.places.T, *(one for one in (self.headings, self.speeds) if one is not None)]
        if not all(np.isfinite(one).all() for one in rows):
            raise UsageError(f"{self.where}: has a time, position, heading or speed that is no finite number")
        if np.abs(self.places).max() > _FARTHEST:
            raise UsageError(f"{self.where}: has a position beyond {_FARTHEST:g} m: are positions in m?")
        steps = np.diff(self.times)
        if (steps <= 0.0).any():
            raise UsageError(f"{self.where}: times must increase strictly, in s")
        if self.times[-1] - self.times[0] > LONGEST:
            raise UsageError(
                f"{self.where}: lasts {self.times[-1] - self.times[0]:.4g} s, more than {LONGEST:g} s: are times in s? "
                "Cut it to the trial"
            )
        moved = np.hypot(*np.diff(self.places, axis=0).T)
        worst = int(np.argmax(moved - FASTEST * steps))
        if moved[worst] > FASTEST * steps[worst] + _JITTER:
            raise UsageError(
                f"{self.where}: moves {moved[worst]:.3g} m in {steps[worst]:.3g} s: are positions in m and times in s?"
            )
        self._check_leaps()
        if self.speeds is not None:
            self._check_speeds(float(moved.sum()), self.speeds)
        return self

    def _check_leaps(self) -> None:
        """Refuse a position aside of all others, and such as lie elsewhere after a moment than they led to before it.

        Lines through some tenths of a second before and after it are continued to the moment: noise of single
        positions matters little, and a clock that stood still is a leap, too.
        """
        times, places = self.times, self.places
        share = ((times[1:-1] - times[:-2]) / (times[2:] - times[:-2]))[:, None]
        aside = np.hypot(*(places[1:-1] - (1.0 - share) * places[:-2] - share * places[2:]).T)
        off = aside - _JITTER - 0.125 * _BRAKES * (times[2:] - times[:-2]) ** 2
        if off.max() > 0.0:
            row = int(np.argmax(off)) + 1
            raise UsageError(
                f"{self.where}: is {aside[row - 1]:.2g} m off the line between the positions before and after at "
                f"{times[row]:.2f} s: positions without jumps are needed"
            )
        first = np.searchsorted(times, times - _FIT - 1e-9)
        last = np.searchsorted(times, times + _FIT + 1e-9)
        rows = np.arange(len(times) - 1)
        rows = rows[(rows + 1 - first[:-1] >= _FEWEST) & (last[1:] - 1 - rows >= _FEWEST)]
        if not rows.size:
            return
        hole = times[rows + 1] - times[rows]
        at = times[rows] + 0.5 * hole
        before = _continued(times, places, first[rows], rows + 1, at)
        after = _continued(times, places, rows + 1, last[rows + 1], at)
        leap = np.hypot(*(after - before).T)
        # Of a line through w seconds, continued by h/2 where braking begins or ends.
        could = _JITTER + _BRAKES * (_FIT**2 / 12.0 + 0.25 * _FIT * hole + 0.125 * hole**2)
        worst = int(np.argmax(leap - could))
        if leap[worst] > could[worst]:
            raise UsageError(
                f"{self.where}: is {leap[worst]:.2g} m from where it was going to at {at[worst]:.2f} s: is it one "
                "object, by one clock?"
            )

    def _check_speeds(self, way: float, speeds: FloatArray) -> None:
        """Refuse speeds over which the object would have gone another way than it did."""
        said = float(np.trapezoid(np.abs(speeds), self.times))
        if max(way, said) < _MOVES * (self.times[-1] - self.times[0]):
            return
        ratio = said / max(way, 1e-9)
        if not 1.0 / _SAME_SPEED <= ratio <= _SAME_SPEED:
            hint = ": is it in km/h?" if abs(ratio - 3.6) < 0.5 else ""
            raise UsageError(f"{self.where}: its speed is {ratio:.2g} times that of its positions{hint}")
        low, high = (
            np.maximum(self.times - 0.5 * _OVER, self.times[0]),
            np.minimum(self.times + 0.5 * _OVER, self.times[-1]),
        )
        (x0, y0), (x1, y1) = ([np.interp(at, self.times, one) for one in self.places.T] for at in (low, high))
        seen, stated = np.hypot(x1 - x0, y1 - y0) / (high - low), np.abs(speeds)
        off = np.abs(seen - stated) - _SLACK - (_SAME_SPEED - 1.0) * np.maximum(seen, stated)
        worst = int(np.argmax(off))
        if off[worst] > 0.0:
            raise UsageError(
                f"{self.where}: its speed is {stated[worst]:.2g} m/s at {self.times[worst]:.2f} s, and that of its "
                f"positions {seen[worst]:.2g} m/s"
            )

    def placed(self, frame: RecordingFrame) -> Track:
        """Return it in the frame `map`."""
        cos, sin = math.cos(frame.turned), math.sin(frame.turned)
        x, y = (self.places - np.array([frame.x, frame.y])).T
        headings = None if self.headings is None else self.headings - frame.turned
        places = np.column_stack([cos * x + sin * y, cos * y - sin * x])
        return Track(self.times, places, headings, self.speeds, self.where)

    def at(self, times: FloatArray) -> FloatArray:
        """Return where it was at some times (s), n × 2, m, in straight lines between positions.

        Raises:
            UsageError: it was not tracked at one of them, or has a hole there.
        """
        if times[0] < self.times[0] - 1e-6 or times[-1] > self.times[-1] + 1e-6:
            raise UsageError(
                f"{self.where}: is tracked from {self.times[0]:.2f} to {self.times[-1]:.2f} s, and the trial is from "
                f"{times[0]:.2f} to {times[-1]:.2f} s"
            )
        after = np.clip(np.searchsorted(self.times, times), 1, len(self.times) - 1)
        holes = np.diff(self.times)[after - 1]
        if holes.max() > LONGEST_HOLE:
            raise UsageError(f"{self.where}: has a hole of {holes.max():.2f} s, more than {LONGEST_HOLE:g} s")
        return np.column_stack([np.interp(times, self.times, column) for column in self.places.T])

    def velocity_at(self, times: FloatArray, over: float) -> FloatArray:
        """Return its velocity at some times (s), n × 2, m/s: by where it was half of `over` (s) before and after."""
        before = np.maximum(times - 0.5 * over, self.times[0])
        after = np.minimum(times + 0.5 * over, self.times[-1])
        return np.asarray((self.at(after) - self.at(before)) / (after - before)[:, None])

    def headings_at(self, times: FloatArray, over: float) -> FloatArray:
        """Return where it points at some times (s), rad: as is said, else the way that it moves, kept while it stands.

        Raises:
            UsageError: nothing is said, and it stands all the time.
        """
        if self.headings is not None:
            return np.interp(times, self.times, np.unwrap(self.headings))
        velocity = self.velocity_at(times, over)
        moves = np.flatnonzero(np.hypot(*velocity.T) >= _MOVES)
        if not moves.size:
            raise UsageError(
                f"{self.where}: stands all the time and says no heading, so nothing is known of where it points"
            )
        kept = moves[np.maximum(0, np.searchsorted(moves, np.arange(len(times)), side="right") - 1)]
        return np.unwrap(np.arctan2(velocity[kept, 1], velocity[kept, 0]))

    def speeds_at(self, times: FloatArray, over: float) -> FloatArray:
        """Return its speed at some times (s), m/s: as is said, or else that of its positions."""
        if self.speeds is not None:
            return np.interp(times, self.times, np.abs(self.speeds))
        return np.asarray(np.hypot(*self.velocity_at(times, over).T))


def _continued(times: FloatArray, places: FloatArray, first: IntArray, last: IntArray, at: FloatArray) -> FloatArray:
    """Return where lines by least squares through rows `first` to `last` (exclusive) lead at some times, n × 2, m."""
    centre = times - times[0]
    count = (last - first).astype(np.float64)

    def over(values: FloatArray) -> FloatArray:
        total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
        return np.asarray(total[last] - total[first])

    t, tt = over(centre) / count, over(centre**2)
    near = places - places[0]
    x, tx = over(near) / count[:, None], over(near * centre[:, None])
    slope = (tx - (count * t)[:, None] * x) / (tt - count * t**2)[:, None]
    return np.asarray(places[0] + x + slope * (at - times[0] - t)[:, None])
