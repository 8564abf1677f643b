"""Tracked objects of recordings: of bags, by topic, id or frame, and of csv tables, by id.

A name in a bag is a topic of Odometry, of a pose or of a point, as `/ego/odometry`; `/tf:base_link` is a frame of /tf,
and `/detections:42` the object of a Detection3DArray, or of Autoware's TrackedObjects, with this id. Times are those of
the messages' stamps.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from skd_adversary.safe_trajectories.recordings import csv_rows, header_of
from skd_sim.errors import UsageError
from skd_sim.ros.from_messages import from_stamp
from skd_sim.world.state import FloatArray

from skd_evaluator.bags.checks import Damage
from skd_evaluator.bags.messages import Condition, Received, read_messages, shortened
from skd_evaluator.bags.transforms import SECOND, At, Transforms, bare, zigzag

TABLE_CAR, TABLE_OTHER = "car", "other"
"""Ids of car and road user in a table, unless said otherwise."""
LONGEST_GAP = 0.5
"""s between two positions, or transforms, over which nothing is filled in: a car at 50 km/h moves 7 m in it."""
USUAL_CAR = "/ego/odometry"
TF = "/tf"
"""Topic of transforms; those that are fixed are on the one of this name with `_static` behind."""
FASTEST = 70.0
"""m/s that no road user exceeds between two positions, jumps of a few centimetres left aside."""
_BASE = "base_link"  # REP 105
_JITTER = 0.3  # m
_ZIGZAG, _OFTEN = 0.15, 0.2  # m to and fro in a fifth of all positions: of no sensor
_RATES = 1.0, 1000.0  # positions per second
_FARTHEST = 1e8  # m; UTM's coordinates stay below a tenth of it
_FEW = 8  # names in a message
_LATE = SECOND  # ns by which a message may be recorded behind a later one
_SAME = 1e-3  # m between two places that are one
_TRANSFORMS = "tf2_msgs/msg/TFMessage"
_READ = (
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/PointStamped",
    "vision_msgs/msg/Detection3DArray",
    "autoware_perception_msgs/msg/TrackedObjects",
)


@dataclass(frozen=True)
class RecordingFrame:
    """Where the frame `map` of the scenario lies in a recording's frame: origin, m, and heading of its x axis, rad."""

    x: float = 0.0
    y: float = 0.0
    turned: float = 0.0


@dataclass(frozen=True, eq=False)
class Track:
    """One tracked object.

    Attributes:
        times: n ≥ 2, s from `origin` on, strictly increasing.
        places: n × 2, m.
        where: file and name, for messages.
        headings: n, rad; None where the recording does not say.
        speeds: n, m/s; None where the recording does not say.
        name: topic, id or name in the file.
        kind: what the file says it is; empty where it does not say.
        frame: name of its frame; empty where it has none.
        origin: where its times begin on the file's clock, s.
        form: how the file says where it is.
        drawn: whether the file defines it in straight lines between its positions, however far apart they are.
        notes: what was done with it, or left out of it.

    Raises:
        UsageError: it has too few positions, one that is not finite or not in m, or times that do not increase.
    """

    times: FloatArray
    places: FloatArray
    where: str
    headings: FloatArray | None = None
    speeds: FloatArray | None = None
    name: str = ""
    kind: str = ""
    frame: str = ""
    origin: float = 0.0
    form: str = ""
    drawn: bool = False
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        count = len(self.times)
        if count < 2:
            raise UsageError(f"{self.where}: {count} position{'' if count == 1 else 's'}; a track has at least two")
        given = (self.times, self.places, self.headings, self.speeds)
        if not all(one is None or np.isfinite(one).all() for one in given):
            raise UsageError(f"{self.where}: has a time, position, heading or speed that is no finite number")
        wrong = np.flatnonzero(np.diff(self.times) <= 0.0)
        if wrong.size:
            row = int(wrong[0])
            before, after = (self.origin + self.times[row : row + 2]).tolist()
            apart = float(np.hypot(*(self.places[row + 1] - self.places[row])))
            why = f"times fall from {before:.2f} to {after:.2f} s; they must increase"
            if before == after:
                why = f"is in two places, {apart:.3g} m apart, at {before:.2f} s (at {wrong.size} of {count} positions)"
            raise UsageError(f"{self.where}: {why}")
        if np.abs(self.places).max() > _FARTHEST:
            raise UsageError(f"{self.where}: has a position beyond {_FARTHEST:g} m: are positions in m?")

    @classmethod
    def of_rows(
        cls,
        rows: Sequence[Sequence[float]] | FloatArray,
        where: str,
        name: str,
        kind: str = "",
        form: str = "",
        *,
        drawn: bool = False,
    ) -> Track:
        """Return the track of rows of time (s), x and y (m), in their order; one that is there twice counts once."""
        table = np.array(list(dict.fromkeys(map(tuple, np.asarray(rows).tolist()))), np.float64).reshape(-1, 3)
        return cls(table[:, 0], table[:, 1:], where, name=name, kind=kind, form=form, drawn=drawn)

    @property
    def jump(self) -> str:
        """Its first step that no road user makes, in words; empty without any."""
        steps, moved = np.diff(self.times), np.hypot(*np.diff(self.places, axis=0).T)
        wrong = np.flatnonzero(moved > FASTEST * steps + _JITTER)
        if wrong.size:
            row = int(wrong[0])
            return f"moves {moved[row]:.3g} m in {steps[row]:.3g} s: are positions in m and times in s?"
        off = zigzag(self.times, self.places)
        leaps = off[off > _ZIGZAG]
        if not self.drawn and len(self.times) >= 5 and len(leaps) > _OFTEN * len(self.times):
            return f"leaps to and fro by {np.median(leaps):.2g} m at {len(leaps)} of {len(self.times)} positions"
        return ""

    def rate(self, longest: float) -> str:
        """Its usual step, if longer than a limit (s) or shorter than any sensor's, in words; empty otherwise."""
        usual = float(np.median(np.diff(self.times)))
        if usual < 1.0 / _RATES[1]:
            return f"{1.0 / usual:.3g} positions a second: are times in s?"
        if usual <= longest * (1.0 + 1e-6):
            return ""
        unit = ": are times in s?" if usual > 1.0 / _RATES[0] else ""
        return f"a position each {usual:.3g} s, longer than --longest-gap {longest:g} s{unit}"

    def gap(self, longest: float) -> str:
        """Its longest step, if that is longer than a limit (s) or than any sensor's, in words; empty otherwise."""
        if self.drawn:
            return ""
        steps = np.diff(self.times)
        row = int(np.argmax(steps))
        if (said := self.rate(longest)) or steps[row] <= longest * (1.0 + 1e-6):
            return said
        begin, end = (self.origin + self.times[row : row + 2]).tolist()
        said = f"a gap of {steps[row]:.2f} s, longer than --longest-gap {longest:g} s, from {begin:.2f} to {end:.2f} s"
        return "; ".join((said, *self.notes))

    def cut(self, begin: float | None, end: float | None) -> Track:
        """Return what of it is between two times on the file's clock, s; None: as far as it goes."""
        clock = self.origin + self.times
        rows = (clock >= (-math.inf if begin is None else begin)) & (clock <= (math.inf if end is None else end))
        names = ("times", "places", "headings", "speeds")
        return replace(self, **{name: one[rows] for name in names if (one := getattr(self, name)) is not None})

    def placed(self, frame: RecordingFrame) -> Track:
        """Return it in the frame `map`."""
        cos, sin = math.cos(frame.turned), math.sin(frame.turned)
        x, y = (self.places - np.array([frame.x, frame.y])).T
        headings = None if self.headings is None else self.headings - frame.turned
        return replace(self, places=np.column_stack([cos * x + sin * y, cos * y - sin * x]), headings=headings)


def one_frame(path: Path, *tracks: Track) -> None:
    """Refuse tracks that are in two frames."""
    first = tracks[0]
    for other in tracks[1:]:
        if other.frame != first.frame:
            frames = f"{first.name} is in frame {first.frame!r} and {other.name} in {other.frame!r}"
            raise UsageError(f"{path}: {frames}; give --map-frame, if /tf was recorded")


def listed(names: Collection[str]) -> str:
    """Return names in a few words."""
    shown = ", ".join(repr(" ".join(one.split())[:40]) for one in list(names)[:_FEW])
    return f"{shown} and {len(names) - _FEW} more" if len(names) > _FEW else shown or "nothing that moves"


class Listed(NamedTuple):
    """What a file holds of one object.

    Attributes:
        name: topic, topic and id, frame, id or name.
        form: how the file says where it is.
        positions: how many there are.
        times: of its positions, on the file's clock, s.
        frame: name of its frame; empty where it has none.
        why: why it is not read; empty where it is.
    """

    name: str
    form: str
    positions: int
    times: FloatArray
    frame: str = ""
    why: str = ""

    @classmethod
    def of(cls, track: Track) -> Listed:
        """Return what is to be said of a track."""
        why = "; ".join(filter(None, (track.jump, *track.notes)))
        return cls(track.name, track.form, len(track.times), track.origin + track.times, track.frame, why)

    def as_dict(self) -> dict[str, Any]:
        """Return it as numbers: rate (1/s), gaps and the longest step (s) among them."""
        steps = np.diff(self.times)
        usual = float(np.median(steps)) if steps.size else 0.0
        return {
            "name": self.name,
            "form": self.form,
            "count": self.positions,
            "rate": 1.0 / usual if usual > 0.0 else None,
            "gaps": int((steps > GAP * usual).sum()),
            "longest_step": float(steps.max()) if steps.size else None,
            "begins": float(self.times[0]) if len(self.times) else None,
            "ends": float(self.times[-1]) if len(self.times) else None,
            "frame": self.frame,
            "why": self.why,
        }


def track_or_why(
    where: str,
    name: str,
    form: str,
    read: Callable[..., Track],
    *arguments: Any,
    times: Sequence[float] | FloatArray = (),
) -> Track | Listed:
    """Return what `read` returns for some arguments, or why that is no track.

    Args:
        where: file and name, with which messages begin.
        name: of the object.
        form: how the file says where it is.
        read: raises a UsageError where there is none.
        arguments: of it.
        times: of its positions, as far as they are known, s.
    """
    try:
        return read(*arguments)
    except UsageError as error:
        why = str(error).removeprefix(where).removeprefix(": ")
        return Listed(name, form, len(times), np.array(times, np.float64), why=why)


GAP = 1.5
"""Times the usual step, from which on a step is a gap."""


# --- bags


class _Row(NamedTuple):
    """One message's word of one object: recorder's time and stamp (ns), frame, place, heading (rad), speed (m/s)."""

    logged: int
    stamp: int
    frame: str
    x: float
    y: float
    z: float
    heading: float
    speed: float


def bag_tracks(
    files: Sequence[Path],
    names: Sequence[str],
    map_frame: str | None = None,
    *,
    longest_gap: float = LONGEST_GAP,
    tf: str = TF,
    damage: Damage | None = None,
) -> dict[str, Track]:
    """Return objects of a recording, by name; their times have one origin.

    Args:
        files: the files of one recording.
        names: a topic, a topic and an id with a colon in between, or a topic of transforms with a frame, `/tf:FRAME`.
        map_frame: frame of the positions; None: that in which they are recorded, of /tf the highest.
        longest_gap: time between two transforms, s, beyond which places are not known.
        tf: topic of the transforms by which others come into `map_frame`.
        damage: takes note of what is left out; by default that is refused.

    Raises:
        UsageError: it cannot be read, lacks one of them, does not say how frames lie or when it was, or its clock goes
            back.
    """
    topics = {name.partition(":")[0] for name in names} | ({tf} if map_frame is not None else set())
    requested = topics | {f"{topic}_static" for topic in topics}
    bag = _Bag(files, requested.__contains__, longest_gap, damage or Damage())
    within = None if map_frame is None else bare(map_frame)
    found = {name: bag.rows_of(name, within, tf) for name in names}
    if len({by_stamps for _, by_stamps in found.values()}) > 1:
        raise UsageError(f"{bag.where}: some of {', '.join(names)} have no stamps: when both were where is unknown")
    origin = min(rows[0].stamp for rows, _ in found.values())
    return {
        name: bag.track(name, rows, origin, within, tf, by_stamps=by_stamps)
        for name, (rows, by_stamps) in found.items()
    }


def bag_objects(
    files: Sequence[Path],
    car: str | None = None,
    map_frame: str | None = None,
    *,
    longest_gap: float = LONGEST_GAP,
    tf: str = TF,
    damage: Damage | None = None,
) -> tuple[Track, list[Track | Listed]]:
    """Return the car of a recording, and every other object in its frame or why it is not there; times as the car's.

    Args:
        files: the files of one recording.
        car: name of the car, as of `bag_tracks`; None: SKD's own, else the only Odometry, else `/tf:base_link`.
        map_frame: frame of the positions; None: that of the car.
        longest_gap: as of `bag_tracks`.
        tf: topic of the transforms.
        damage: takes note of what is left out; by default that is refused.

    Raises:
        UsageError: it cannot be read, or does not say where the car is.
    """
    bag = _Bag(files, lambda _topic: True, longest_gap, damage or Damage())
    car = bag.likely_car(tf) if car is None else car
    rows, by_stamps = bag.rows_of(car, None if map_frame is None else bare(map_frame), tf)
    origin, within = rows[0].stamp, None if map_frame is None else bare(map_frame)
    own = bag.track(car, rows, origin, within, tf, by_stamps=by_stamps)

    def beside(name: str) -> Track:
        found, stamped = bag.rows_of(name, own.frame, tf)
        if stamped != by_stamps:
            raise UsageError("it or the car has no stamps, so it is unknown when both were where")
        return bag.track(name, found, origin, own.frame, tf, by_stamps=by_stamps)

    every = ((_named(topic, id_), topic, rows) for topic, ids in bag.rows.items() for id_, rows in ids.items())
    return own, [
        track_or_why(
            f"{bag.where}, {name}", name, bag.topics[topic], beside, name,
            times=[(one.stamp - origin) / SECOND for one in rows],
        )
        for name, topic, rows in every
        if name != car
    ]  # fmt: skip


def bag_listing(files: Sequence[Path], damage: Damage, topics: Collection[str] = ()) -> list[Listed]:
    """Return what a recording holds: each object and frame, then the topics that are not read.

    Args:
        files: the files of one recording.
        damage: takes note of what is left out.
        topics: only these; empty: all.
    """
    bag = _Bag(files, lambda topic: not topics or topic in topics, LONGEST_GAP, damage)
    found = []
    for topic, ids in bag.rows.items():
        for id_, rows in ids.items():
            times, why = np.array(sorted({one.stamp for one in rows}), np.float64) / SECOND, ""
            if (topic, id_) in bag.unnamed:
                why = "several objects of one message have this id"
            elif len(times) < len(rows):
                unset = sum(one.stamp == 0 for one in rows)
                count, what = (unset, "0") if unset > 1 else (len(rows) - len(times), "there more than once")
                why = f"{count} of {len(rows)} stamps are {what}"
            frames = ", ".join(dict.fromkeys(one.frame for one in rows))
            found.append(Listed(_named(topic, id_), bag.topics[topic], len(rows), times, frames, why))
    for topic, tree in bag.trees.items():
        for child, parents, moves, times in tree.summary():
            form = "a moving frame" if moves else "a fixed frame"
            found.append(Listed(f"{topic}:{child}", form, len(times), times if moves else times[:0], parents))
    for topic, kind in sorted(bag.topics.items()):
        known = kind in (*_READ, _TRANSFORMS)
        why = "none of its messages can be read" if known else "of a type that is not read"
        read = topic in bag.rows or topic.removesuffix("_static") in bag.trees
        if not read and bag.counts[topic] >= known and (not topics or topic in topics):
            found.append(Listed(topic, kind, bag.counts[topic], np.zeros(0), why=why))
    return found


def _named(topic: str, id_: str) -> str:
    return f"{topic}:{id_}" if id_ else topic


class _Bag:
    """What was read of a recording.

    Attributes:
        where: the recording, for messages.
        rows: of each topic the rows of each object, by id.
        trees: the transforms of each topic of such.
        unnamed: topics with ids that several objects of one message have.
        topics: the type of each topic.
        counts: how many messages each topic has.
    """

    def __init__(
        self, files: Sequence[Path], requested: Callable[[str], bool], longest_gap: float, damage: Damage
    ) -> None:
        """Read what is on requested topics; what cannot be read is left out."""
        self.where = str(files[0] if len(files) == 1 else files[0].parent)
        self.rows: dict[str, dict[str, list[_Row]]] = {}
        self.trees: dict[str, Transforms] = {}
        self.unnamed: set[tuple[str, str]] = set()
        self.topics: dict[str, str] = {}
        self.counts: Counter[str] = Counter()
        self._longest_gap, self._damage, self._files = longest_gap, damage, files
        for file in files:
            condition = Condition()
            for received in read_messages(file, requested, damage, condition):
                if received.type not in (*_READ, _TRANSFORMS):
                    continue
                try:
                    self._add(received, received.decoded())
                except UsageError as error:
                    damage.leave_out(f"{file}: {error}")
            self.topics.update(condition.topics)
            self.counts.update(condition.counts)

    def _add(self, received: Received, message: Any) -> None:
        topic = received.topic
        if received.type == _TRANSFORMS:
            name = topic.removesuffix("_static")
            tree = self.trees.setdefault(name, Transforms(self.where, self._longest_gap))
            for one in message.transforms:
                p, q = one.transform.translation, one.transform.rotation
                place = tuple(map(float, (p.x, p.y, p.z, q.x, q.y, q.z, q.w)))
                frames = str(one.header.frame_id), str(one.child_frame_id)
                tree.add(*frames, from_stamp(one.header.stamp), received.logged, place, fixed=topic != name)
            return
        ids = self.rows.setdefault(topic, {})
        seen: set[str] = set()
        for id_, row in _objects(received, message):
            if id_ in seen:
                self.unnamed.add((topic, id_))
            seen.add(id_)
            ids.setdefault(id_, []).append(row)

    def likely_car(self, tf: str) -> str:
        """Return the name of what is the car if anything is.

        Raises:
            UsageError: nothing is, or several may be.
        """
        poses = [topic for topic, kind in self.topics.items() if kind.endswith("Odometry") and topic in self.rows]
        if USUAL_CAR in poses or len(poses) == 1:
            return USUAL_CAR if USUAL_CAR in poses else poses[0]
        if not poses and tf in self.trees and _BASE in self.trees[tf].frames:
            return f"{tf}:{_BASE}"
        some = f"it may be {listed(poses)}" if poses else f"it has no Odometry and no frame {_BASE!r}"
        raise UsageError(f"{self.where}: which object is the car is unknown: {some}; name it by --car")

    def rows_of(self, name: str, map_frame: str | None, tf: str) -> tuple[list[_Row], bool]:
        """Return the rows of an object or a frame by their times, and whether these are stamps.

        Raises:
            UsageError: there is none, or they are of no use.
        """
        topic, _, id_ = name.partition(":")
        kind, ids = self.topics.get(topic), self.rows.get(topic, {})
        if topic in self.trees or kind == _TRANSFORMS:
            return self._rows_of_frame(topic, bare(id_), map_frame), True
        if id_ in ids:
            return self._clean(topic, id_, map_frame)
        if ids:
            known = ", ".join(map(shortened, list(ids)[:_FEW]))
            raise UsageError(f"{self.where}: {topic} has several objects; it has {known}: name one as {topic}:ID")
        if kind is not None and kind not in _READ:
            raise UsageError(f"{self.where}: {topic} has type {shortened(kind)}; it must be one of {', '.join(_READ)}")
        if faults := [line for line in self._damage.left_out if line.startswith(tuple(map(str, self._files)))]:
            raise UsageError(f"{faults[-1]}: nothing of {topic}")
        readable = [one for one, kind in self.topics.items() if kind in (*_READ, _TRANSFORMS)]
        some = f"it has {listed(readable)}: name them by --car and --road-user"
        count = len(self.topics)
        none = f"none of its {count} topics is of a type that is read: {', '.join(_READ)}" if count else "it is empty"
        raise UsageError(f"{self.where}: has no message on {topic}; {some if readable else none}")

    def _rows_of_frame(self, topic: str, frame: str, map_frame: str | None) -> list[_Row]:
        """Return when a frame is said to lie somewhere, at its own origin."""
        tree = self.trees.get(topic)
        if tree is None or frame not in tree.frames:
            some = listed(tree.frames) if tree else "no frame"
            raise UsageError(f"{self.where}: {topic} has no frame {frame!r} but {some}; name it as {topic}:FRAME")
        at = tree.times(frame, tree.root(frame) if map_frame is None else self._known(topic, map_frame))
        times = zip(at.stamps.tolist(), at.logged.tolist(), strict=True)
        return [_Row(logged, stamp, frame, 0.0, 0.0, 0.0, 0.0, math.nan) for stamp, logged in times]

    def _known(self, tf: str, frame: str) -> str:
        """Return a frame, if the transforms on a topic have it."""
        tree = self.trees.get(tf)
        if tree is not None and frame in tree.frames:
            return frame
        others = [one for one, kind in self.topics.items() if kind == _TRANSFORMS and one.removesuffix("_static") != tf]
        some = listed(tree.frames) if tree else "no frame"
        more = f"; transforms are on {listed(others)}, too: name one by --tf-topic" if others else ""
        raise UsageError(f"{self.where}: --map-frame {frame}: {tf} does not know it, but {some}{more}")

    def _clean(self, topic: str, id_: str, map_frame: str | None) -> tuple[list[_Row], bool]:
        """Return the rows of an object by their times, without those of no use, and whether these are stamps."""
        where, damage = f"{self.where}: {topic}", self._damage
        if (topic, id_) in self.unnamed:
            raise UsageError(f"{where}: several objects of one message have the id {id_!r}: which is which is unknown")
        rows = sorted(self.rows[topic][id_], key=lambda one: one.logged)
        count, unset = len(rows), [index for index, one in enumerate(rows) if one.stamp <= 0]
        by_stamps = len(unset) < count
        if not by_stamps:
            if map_frame is not None and {one.frame for one in rows} != {map_frame}:
                raise UsageError(f"{where}: all {count} stamps are 0, so nothing says how frames lay then")
            damage.warn(
                f"{where}: the stamps of {count} of {count} messages are 0 (not filled in): {_RECORDER} are taken"
            )
            rows = [one._replace(stamp=one.logged) for one in rows]
        elif len(unset) > 1 or (unset and unset[0] > 0) or (unset and count > 2 and rows[1].stamp > _LATE):
            said = f"the stamps of {len(unset)} of {count} messages are 0 (before the clock began): left out"
            damage.warn(f"{where}: {said}")
            rows = [one for one in rows if one.stamp > 0]
        for before, after in pairwise(rows):
            if after.stamp < before.stamp - _LATE:
                back = f"from {before.stamp / SECOND:.2f} to {after.stamp / SECOND:.2f} s"
                raise UsageError(f"{where}: the clock goes back {back}: is it of several drives? Cut it to one")
        usable = [one for one in rows if all(map(math.isfinite, one[3:6]))]
        if len(usable) < len(rows):
            first = min(one.stamp for one in rows if not all(map(math.isfinite, one[3:6]))) / SECOND
            said = (
                f"{len(rows) - len(usable)} of {count} positions are no numbers (the first at {first:.2f} s): left out"
            )
            damage.warn(f"{where}: {said}")
        by_stamp: dict[int, _Row] = {}
        twice: list[tuple[float, int]] = []
        for one in usable:
            same = by_stamp.setdefault(one.stamp, one)
            if (apart := math.dist(same[3:6], one[3:6])) > _SAME or same.frame != one.frame:
                twice.append((apart, one.stamp))
        if twice:
            apart, stamp = twice[0]
            said = f"the stamp {stamp / SECOND:.2f} s is there twice, with places {apart:.3g} m apart"
            raise UsageError(f"{where}: {said} ({len(twice)} of {count} messages repeat one): two publishers?")
        if not by_stamp:
            raise UsageError(f"{where}: nothing that can be used is left of {count} messages")
        return [by_stamp[stamp] for stamp in sorted(by_stamp)], by_stamps

    def track(
        self, name: str, rows: Sequence[_Row], origin: int, map_frame: str | None, tf: str, *, by_stamps: bool
    ) -> Track:
        """Return the track of rows by their times (ns, from `origin` on), in the frame in which it is requested."""
        topic, where = name.partition(":")[0], f"{self.where}, {name}"
        is_frame = topic in self.trees and topic not in self.rows
        frames, by = list(dict.fromkeys(one.frame for one in rows)), topic if is_frame else tf
        if map_frame is not None:
            within = map_frame if frames == [map_frame] else self._known(by, map_frame)
        elif len(frames) > 1:
            raise UsageError(f"{self.where}: {topic} is in two frames, {frames[0]!r} and {frames[1]!r}")
        else:
            within = self.trees[topic].root(frames[0]) if is_frame else frames[0]
        stamps, logged = np.array([(one.stamp, one.logged) for one in rows], np.int64).T
        table = np.array([one[3:] for one in rows], np.float64)
        known, notes = np.ones(len(rows), bool), list[str]()
        for frame in frames:
            if frame != within:
                chosen = np.flatnonzero([one.frame == frame for one in rows])
                at = At(stamps[chosen], logged[chosen])
                table[chosen, :4], known[chosen], said = self.trees[by].moved(table[chosen, :4], frame, within, at)
                notes += said
        for note in notes:
            self._damage.warn(f"{where}: {note}")
        lost = int((~known).sum())
        if lost and known.sum() < 2:
            why = "; ".join(notes) or f"nothing says how {frames[0]!r} lies in {within!r}"
            raise UsageError(f"{where}: no place of it is known in {within!r}: {why}")
        if lost:
            notes.append(f"{lost} of {len(rows)} positions left out for it")
            self._damage.warn(f"{where}: {notes[-1]}")
        form = "transforms" if is_frame else self.topics[topic] + ("" if by_stamps else f", {_RECORDER}")
        times, (x, y, _, headings, speeds) = (stamps[known] - origin) / SECOND, table[known].T
        return Track(
            times, np.column_stack([x, y]), where, _complete(headings), _complete(speeds), name, frame=within,
            origin=origin / SECOND, form=form, notes=tuple(notes),
        )  # fmt: skip


_RECORDER = "the recorder's times"


def _objects(received: Received, message: Any) -> Iterator[tuple[str, _Row]]:
    """Yield id (empty where the topic has one object) and row of each object."""
    kind = received.type
    if kind.endswith("Detection3DArray"):
        for one in message.detections:
            id_ = getattr(one, "id", None)
            if id_ is None:
                id_ = getattr(one, "tracking_id", "")  # before ROS 2 Humble
            yield str(id_), _row(received, (one.header, message.header), one.bbox.center)
    elif kind.endswith("TrackedObjects"):
        for one in message.objects:
            pose = one.kinematics.pose_with_covariance.pose
            yield bytes(one.object_id.uuid).hex(), _row(received, (message.header,), pose)
    elif kind.endswith("Odometry"):
        linear = message.twist.twist.linear
        yield "", _row(received, (message.header,), message.pose.pose, math.hypot(linear.x, linear.y))
    elif kind.endswith("PointStamped"):
        yield "", _row(received, (message.header,), message.point)
    else:
        yield "", _row(received, (message.header,), getattr(message.pose, "pose", message.pose))


def _row(received: Received, headers: Sequence[Any], pose: Any, speed: float = math.nan) -> _Row:
    """Return the row of a pose or a point; stamp and frame are of the first header that has one."""
    p, q = getattr(pose, "position", pose), getattr(pose, "orientation", None)
    heading = math.nan
    if q is not None and abs(q.w**2 + q.x**2 + q.y**2 + q.z**2 - 1.0) < 1e-3:  # else it was not filled in
        heading = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y**2 + q.z**2))
    stamp = next((at for one in headers if (at := from_stamp(one.stamp))), 0)
    frame = next((name for one in headers if (name := bare(str(one.frame_id)))), "")
    return _Row(received.logged, stamp, frame, float(p.x), float(p.y), float(p.z), heading, float(speed))


def _complete(values: FloatArray) -> FloatArray | None:
    return None if not np.isfinite(values).all() else values


# --- tables

_FURTHER = ("heading", "speed")


def table_tracks(path: Path, names: Collection[str] = ()) -> dict[str, Track | Listed]:
    """Return objects of a csv table with the columns t, id, x, y, and perhaps heading and speed, by id.

    Args:
        path: the file.
        names: ids of those to be read; empty: all, and of those that cannot be, why.

    Raises:
        UsageError: it cannot be read, has another layout, a value that is no number, or lacks one of them.
    """
    rows: dict[str, dict[tuple[float, ...], None]] = {}
    further = [name for name in _FURTHER if name in header_of(path)]
    for _, (name,), values in csv_rows(path, ("t", "x", "y", *further), ("id",), empty=further):
        rows.setdefault(name, {})[tuple(values)] = None
    missing = [name for name in names if name not in rows]
    if missing:
        known = listed(sorted(rows))
        raise UsageError(f"{path}: has no object {missing[0]!r} but {known}; name them by --car and --road-user")
    found: dict[str, Track | Listed] = {}
    for name in names or rows:
        table = np.array(sorted(rows[name]), np.float64)
        given = {key: _complete(table[:, 3 + place]) for place, key in enumerate(further)}
        heading, speed = (given.get(key) for key in _FURTHER)
        read = partial(Track, table[:, 0], table[:, 1:3], f"{path}, {name}", heading, speed, name, form="t, id, x, y")
        found[name] = (
            read() if name in names else track_or_why(f"{path}, {name}", name, "t, id, x, y", read, times=table[:, 0])
        )
    return found
