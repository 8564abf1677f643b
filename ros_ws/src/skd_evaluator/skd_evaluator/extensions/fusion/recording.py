"""The tracked objects of a recording: an MCAP file or a bag's folder, or a csv table; by topic, by id, or as a frame.

A name is a topic of Odometry, of a pose or of a point, as `/ego/odometry`; `/tf:base_link` is a frame of /tf, and
`/detections:42` the object of a Detection3DArray with this id.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.inputs.files import finite_number, read_text
from skd_sim.inputs.yaml_file import short
from skd_sim.ros.from_messages import from_stamp

from skd_evaluator.bags.checks import find_recordings
from skd_evaluator.bags.mcap_file import Condition, Received, read_messages, shortened
from skd_evaluator.bags.read import ADVERSARY, CAR
from skd_evaluator.extensions.fusion.track import Track, Transforms

_NANOSECONDS = 1e-9
_TF, _TF_STATIC = "/tf", "/tf_static"
_TRANSFORMS = "tf2_msgs/msg/TFMessage"
_MOST = 2_000_000  # positions
_LATE = 1.0  # s by which a message may be recorded behind a later one


class TrackRow(NamedTuple):
    """A position: s, m, m, and where they are said heading (rad) and speed (m/s); else nan."""

    time: float
    x: float
    y: float
    heading: float
    speed: float


class Sighting(NamedTuple):
    """Somebody at a moment: name (empty where the topic has one object), frame, time (s), place (m), heading, speed."""

    name: str
    frame: str
    time: float
    place: tuple[float, float, float]
    heading: float
    speed: float


@dataclass
class BagTrack:
    """One object of a bag: positions, and the frame that they are in."""

    rows: list[TrackRow] = field(default_factory=list)
    frame: str = ""


def _pose(pose: Any) -> tuple[tuple[float, float, float], float]:
    q, p = pose.orientation, pose.position
    heading = np.arctan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y**2 + q.z**2))
    said = abs(q.w**2 + q.x**2 + q.y**2 + q.z**2 - 1.0) < 1e-3  # else nobody filled it in
    return (float(p.x), float(p.y), float(p.z)), float(heading) if said else np.nan


def _of(message: Any, pose: Any, speed: float = np.nan) -> Iterator[Sighting]:
    header = message.header
    yield Sighting("", str(header.frame_id), _NANOSECONDS * from_stamp(header.stamp), *_pose(pose), speed)


def _odometry(message: Any) -> Iterator[Sighting]:
    linear = message.twist.twist.linear
    return _of(message, message.pose.pose, float(np.hypot(linear.x, linear.y)))


def _point(message: Any) -> Iterator[Sighting]:
    header, p = message.header, message.point
    place = float(p.x), float(p.y), float(p.z)
    yield Sighting("", str(header.frame_id), _NANOSECONDS * from_stamp(header.stamp), place, np.nan, np.nan)


def _detections(message: Any) -> Iterator[Sighting]:
    for one in message.detections:
        header = one.header if one.header.frame_id else message.header
        time = _NANOSECONDS * from_stamp(header.stamp)
        name = one.id if hasattr(one, "id") else one.tracking_id  # before ROS 2 Humble
        yield Sighting(str(name), str(header.frame_id), time, *_pose(one.bbox.center), np.nan)


_READERS: dict[str, Callable[[Any], Iterator[Sighting]]] = {
    "nav_msgs/msg/Odometry": _odometry,
    "geometry_msgs/msg/PoseStamped": lambda message: _of(message, message.pose),
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda message: _of(message, message.pose.pose),
    "geometry_msgs/msg/PointStamped": _point,
    "vision_msgs/msg/Detection3DArray": _detections,
}


def bag_tracks(path: Path, names: Sequence[str], map_frame: str | None = None) -> dict[str, BagTrack]:
    """Return objects of a bag by the names that they are asked for by.

    Args:
        path: an .mcap file or a bag's folder.
        names: a topic, a topic and an id with a colon in between, or `/tf:FRAME`.
        map_frame: frame in which positions are wanted; None: that in which they are, of /tf the highest.

    Raises:
        UsageError: it cannot be read, is damaged, lacks one of them, does not say how frames lie, or its clock goes
            back.
    """
    wanted = {name: (topic, id_) for name in names for topic, _, id_ in [name.partition(":")]}
    topics = {topic for topic, _ in wanted.values()}
    with_frames = map_frame is not None or _TF in topics
    seen: dict[str, list[Sighting]] = {name: [] for name in names}
    known: dict[str, dict[str, None]] = {topic: {} for topic in topics}
    transforms = Transforms(str(path))
    count = 0
    for file in (file for files in find_recordings([path]) for file in files):
        condition = Condition()
        read = topics | ({_TF, _TF_STATIC} if with_frames else set())
        for received in read_messages(file, read.__contains__, condition):
            topic = received.channel.topic
            if received.schema.name == _TRANSFORMS and topic in (_TF, _TF_STATIC):
                _take_transforms(transforms, _read(received, file), static=topic == _TF_STATIC)
                continue
            for sighting in _sightings(received, file):
                known[topic].setdefault(sighting.name)
                for name, asked in wanted.items():
                    if asked == (topic, sighting.name):
                        seen[name].append(sighting)
                        count += 1
            if count > _MOST:
                raise UsageError(f"{path}: has more than {_MOST} positions; cut it to what is wanted")
        if condition.damage:
            raise UsageError(f"{file}: is damaged ({condition.damage[0]})")
    found = {}
    for name, (topic, id_) in wanted.items():
        if topic == _TF and not seen[name]:
            found[name] = _frame_track(path, transforms, id_, map_frame)
        else:
            found[name] = _placed(path, name, seen[name], transforms, map_frame, [*known[topic]])
    return found


def _read(received: Received, file: Path) -> Any:
    try:
        return received.decoded()
    except UsageError as error:
        raise UsageError(f"{file}: {error}") from error


def _sightings(received: Received, file: Path) -> Iterator[Sighting]:
    topic, kind = received.channel.topic, received.schema.name
    if kind not in _READERS:
        raise UsageError(
            f"{file}: {topic} has type {shortened(kind)}; it must be one of {', '.join(_READERS)}, or /tf:FRAME"
        )
    message = _read(received, file)
    yield from _READERS[kind](message)


def _take_transforms(transforms: Transforms, message: Any, *, static: bool) -> None:
    for one in message.transforms:
        p, q = one.transform.translation, one.transform.rotation
        time = _NANOSECONDS * from_stamp(one.header.stamp)
        row = (time, *(float(value) for value in (p.x, p.y, p.z, q.x, q.y, q.z, q.w)))
        transforms.add(str(one.header.frame_id), str(one.child_frame_id), row, static=static)


def _frame_track(path: Path, transforms: Transforms, frame: str, map_frame: str | None) -> BagTrack:
    if frame not in transforms.frames:
        known = ", ".join(map(shortened, transforms.frames[:8])) or "none"
        raise UsageError(f"{path}: /tf has no frame {frame!r} but {known}; name it as /tf:FRAME")
    within = transforms.root(frame) if map_frame is None else _known_frame(path, transforms, map_frame)
    times = transforms.stamps(frame)
    poses = transforms.poses(frame, within, times)
    rows = zip(times.tolist(), poses.places[:, :2].tolist(), poses.headings.tolist(), strict=True)
    return BagTrack([TrackRow(time, x, y, heading, np.nan) for time, (x, y), heading in rows], within)


def _known_frame(path: Path, transforms: Transforms, frame: str) -> str:
    if not transforms.knows(frame):
        known = ", ".join(map(shortened, transforms.frames[:8])) or "no frame"
        raise UsageError(f"{path}: --map-frame {frame}: /tf and /tf_static do not know it; they have {known}")
    return frame


def _placed(
    path: Path,
    name: str,
    seen: Sequence[Sighting],
    transforms: Transforms,
    map_frame: str | None,
    known: Sequence[str],
) -> BagTrack:
    topic = name.partition(":")[0]
    if not seen:
        if any(known):
            ids = ", ".join(map(shortened, known[:8]))
            raise UsageError(f"{path}: {topic} has several objects; it has {ids}: name one as {topic}:ID")
        raise UsageError(f"{path}: has no message on {topic}; name the topics by --car and --road-user")
    frames = list(dict.fromkeys(one.frame for one in seen))
    if len(frames) > 1:
        raise UsageError(f"{path}: {topic} is in two frames, {frames[0]!r} and {frames[1]!r}")
    times = np.array([one.time for one in seen])
    back = np.flatnonzero(np.diff(times) < -_LATE)
    if back.size:
        before, after = times[back[0]], times[back[0] + 1]
        raise UsageError(
            f"{path}: the clock of {topic} goes back from {before:.2f} to {after:.2f} s: is it of several drives? Cut "
            "it to one"
        )
    places, headings = np.array([one.place for one in seen]), np.array([one.heading for one in seen])
    if map_frame is not None and frames[0] != map_frame:
        _known_frame(path, transforms, map_frame)
        order = np.argsort(times, kind="stable")
        times, places, headings = times[order], places[order], headings[order]
        seen = [seen[row] for row in order.tolist()]
        poses = transforms.poses(frames[0], map_frame, times)
        upright = np.column_stack([np.zeros((len(times), 2)), np.sin(0.5 * headings), np.cos(0.5 * headings)])
        placed = poses.on(type(poses)(places, np.where(np.isfinite(upright), upright, [0.0, 0.0, 0.0, 1.0])))
        places, headings = placed.places, np.where(np.isfinite(headings), placed.headings, np.nan)
    rows = zip(times.tolist(), places[:, :2].tolist(), headings.tolist(), seen, strict=True)
    within = frames[0] if map_frame is None else map_frame
    return BagTrack([TrackRow(time, x, y, heading, one.speed) for time, (x, y), heading, one in rows], within)


TABLE_CAR, TABLE_OTHER = "car", "other"
"""Ids of the two in a table, where nothing else is said."""
_COLUMNS = ("t", "id", "x", "y")
_FURTHER = ("heading", "speed")


def read_tracks(path: Path, car: str | None, other: str | None) -> tuple[Track, Track]:
    """Return the tracks of the car and of the other road user, each in the frame in which it was recorded.

    Args:
        path: an .mcap file, a bag's folder, or a csv file with the columns t, id, x, y, and perhaps heading and speed.
        car: topic or id of the car; None: what SKD itself calls it.
        other: topic or id of the other.

    Raises:
        UsageError: it cannot be read, is damaged, lacks one of the two, or they are in two frames.
    """
    if not path.exists():
        raise UsageError(f"{path}: no such file or folder")
    if path.suffix.lower() == ".csv":
        names = car or TABLE_CAR, other or TABLE_OTHER
        rows = _rows_of_table(path, names)
    else:
        names = car or CAR, other or ADVERSARY
        rows = _rows_of_bag(path, names)
    if names[0] == names[1]:
        raise UsageError(f"{path}: car and road user are both {names[0]!r}; say which is which")
    first, second = (_track(rows[name], f"{path}, {name}") for name in names)
    return first, second


def _track(rows: list[TrackRow], where: str) -> Track:
    values = np.array(sorted(dict.fromkeys(rows)), np.float64).reshape(-1, 5)
    said: list[FloatArray | None] = [None if np.isnan(column).any() else column for column in values[:, 3:].T]
    return Track(values[:, 0], values[:, 1:3], said[0], said[1], where).checked()


def _rows_of_bag(path: Path, names: tuple[str, str]) -> dict[str, list[TrackRow]]:
    found = bag_tracks(path, names)
    _check_frames(path, {name: one.frame for name, one in found.items()}, names)
    return {name: one.rows for name, one in found.items()}


def _check_frames(path: Path, frames: dict[str, str], topics: tuple[str, str]) -> None:
    if len({*frames.values()}) > 1:
        said = " and ".join(f"{topic} in {frames[topic]!r}" for topic in topics)
        raise UsageError(f"{path}: {said}: two frames, and nothing says how they lie; record both in one")


def _rows_of_table(path: Path, ids: tuple[str, str]) -> dict[str, list[TrackRow]]:
    rows: dict[str, list[TrackRow]] = {name: [] for name in ids}
    known: set[str] = set()
    try:
        for line, row in _lines(path):
            known.add(row["id"])
            if row["id"] in rows:
                values = (
                    _number(row.get(name, ""), f"{path}, line {line}: {name}", name) for name in (*"txy", *_FURTHER)
                )
                rows[row["id"]].append(TrackRow(*values))
    except csv.Error as error:
        raise UsageError(f"{path}: not csv: {error}") from error
    for name in ids:
        if not rows[name]:
            others = ", ".join(map(short, sorted(known)[:5])) or "none"
            raise UsageError(f"{path}: has no object {name!r} but {others}; name them by --car and --road-user")
    return rows


def _lines(path: Path) -> Iterator[tuple[int, dict[str, str]]]:
    table = csv.DictReader(StringIO(read_text(path), newline=""), strict=True)
    table.fieldnames = [name.strip() for name in table.fieldnames or []]
    for name in _COLUMNS:
        if name not in table.fieldnames:
            raise UsageError(f"{path}, line 1: no column {name!r}; a table of tracks has t, id, x, y[, heading, speed]")
    for name in (*_COLUMNS, *_FURTHER):
        if table.fieldnames.count(name) > 1:
            raise UsageError(f"{path}, line 1: two columns {name!r}")
    for row in table:
        if None in row or None in row.values():
            raise UsageError(f"{path}, line {table.line_num}: has another number of values than the header")
        yield table.line_num, {name: value.strip() for name, value in row.items()}


def _number(text: str, what: str, name: str) -> float:
    if not text and name in _FURTHER:
        return float("nan")
    return finite_number(text, what)
