"""Tracked objects of recordings: of bags, by topic, id or frame, and of csv tables, by id.

A name in a bag is a topic of Odometry, of a pose or of a point, as `/ego/odometry`; `/tf:base_link` is a frame of /tf,
and `/detections:42` the object of a Detection3DArray with this id.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.inputs.files import finite_number, open_regular
from skd_sim.ros.from_messages import from_stamp

from skd_evaluator.bags.checks import find_recordings
from skd_evaluator.bags.mcap_file import Condition, Received, read_messages, shortened
from skd_evaluator.bags.transforms import Poses, Transforms

TABLE_CAR, TABLE_OTHER = "car", "other"
"""Ids of car and road user in a table, unless said otherwise."""
FASTEST = 70.0
"""m/s that no road user exceeds between two positions, jumps of a few centimetres left aside."""
_JITTER = 0.3  # m
_FARTHEST = 1e8  # m; UTM's coordinates stay below a tenth of it
_FEW = 8  # names in a message
_NANOSECONDS = 1e-9
_LATE = 1.0  # s by which a message may be recorded behind a later one
_TF, _TF_STATIC = "/tf", "/tf_static"
_TRANSFORMS = "tf2_msgs/msg/TFMessage"
_READ = (
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/PointStamped",
    "vision_msgs/msg/Detection3DArray",
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
        times: n ≥ 2, s, strictly increasing.
        places: n × 2, m.
        where: file and name, for messages.
        headings: n, rad; None where the recording does not say.
        speeds: n, m/s; None where the recording does not say.
        name: topic, id or name in the file.
        kind: what the file says it is; empty where it does not say.
        frame: name of its frame; empty where it has none.

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

    def __post_init__(self) -> None:
        count = len(self.times)
        if count < 2:
            raise UsageError(f"{self.where}: {count} position{'' if count == 1 else 's'}; a track has at least two")
        given = (one for one in (self.times, self.places, self.headings, self.speeds) if one is not None)
        if not all(np.isfinite(one).all() for one in given):
            raise UsageError(f"{self.where}: has a time, position, heading or speed that is no finite number")
        if (np.diff(self.times) <= 0.0).any():
            raise UsageError(f"{self.where}: times must increase strictly, in s")
        if np.abs(self.places).max() > _FARTHEST:
            raise UsageError(f"{self.where}: has a position beyond {_FARTHEST:g} m: are positions in m?")

    @classmethod
    def of_rows(cls, rows: Sequence[Sequence[float]] | FloatArray, where: str, name: str, kind: str = "") -> Track:
        """Return the track of rows of time (s), x and y (m), in any order but without time twice."""
        table = np.array(rows, np.float64).reshape(-1, 3)
        return cls(table[:, 0], table[:, 1:], where, name=name, kind=kind)

    @property
    def jump(self) -> str:
        """Its first step that no road user makes, in words; empty without any."""
        steps, moved = np.diff(self.times), np.hypot(*np.diff(self.places, axis=0).T)
        wrong = np.flatnonzero(moved > FASTEST * steps + _JITTER)
        if not wrong.size:
            return ""
        row = int(wrong[0])
        return f"moves {moved[row]:.3g} m in {steps[row]:.3g} s: are positions in m and times in s?"

    def placed(self, frame: RecordingFrame) -> Track:
        """Return it in the frame `map`."""
        cos, sin = math.cos(frame.turned), math.sin(frame.turned)
        x, y = (self.places - np.array([frame.x, frame.y])).T
        headings = None if self.headings is None else self.headings - frame.turned
        return replace(self, places=np.column_stack([cos * x + sin * y, cos * y - sin * x]), headings=headings)


def listed(names: Collection[str]) -> str:
    """Return names in a few words."""
    shown = ", ".join(repr(" ".join(one.split())[:40]) for one in list(names)[:_FEW])
    return f"{shown} and {len(names) - _FEW} more" if len(names) > _FEW else shown or "nothing that moves"


# --- bags


def bag_tracks(path: Path, names: Sequence[str], map_frame: str | None = None) -> dict[str, Track]:
    """Return objects of a bag, by name.

    Args:
        path: an .mcap file or a bag's folder.
        names: a topic, a topic and an id with a colon in between, or `/tf:FRAME`.
        map_frame: frame of the positions; None: that in which they are recorded, of /tf the highest.

    Raises:
        UsageError: it cannot be read, is damaged, lacks one of them, does not say how frames lie, or its clock goes
            back.
    """
    topics = {name.partition(":")[0] for name in names}
    read = topics | ({_TF, _TF_STATIC} if map_frame is not None or _TF in topics else set())
    transforms = Transforms(str(path))
    seen: dict[str, dict[str, list[tuple[str, tuple[float, ...]]]]] = {topic: {} for topic in topics}
    for file in (file for files in find_recordings([path]) for file in files):
        condition = Condition()
        for received in read_messages(file, read.__contains__, condition):
            topic, kind = received.channel.topic, received.schema.name
            message = _decoded(received, file)
            if kind == _TRANSFORMS and topic in (_TF, _TF_STATIC):
                _add_transforms(transforms, message, static=topic == _TF_STATIC)
                continue
            for id_, header, pose, speed in _objects(kind, message):
                row = (_NANOSECONDS * from_stamp(header.stamp), *_place_and_heading(pose), speed)
                seen[topic].setdefault(id_, []).append((str(header.frame_id), row))
        if condition.damage:
            raise UsageError(f"{file}: is damaged ({condition.damage[0]})")
    found = {}
    for name in names:
        topic, _, id_ = name.partition(":")
        if topic == _TF and not seen[topic]:
            found[name] = _track_of_frame(path, name, transforms, map_frame)
        elif id_ in seen[topic]:
            found[name] = _track_of_rows(path, name, seen[topic][id_], transforms, map_frame)
        elif seen[topic]:
            ids = ", ".join(map(shortened, list(seen[topic])[:_FEW]))
            raise UsageError(f"{path}: {topic} has several objects; it has {ids}: name one as {topic}:ID")
        else:
            raise UsageError(f"{path}: has no message on {topic}; name the topics by --car and --road-user")
    return found


def _decoded(received: Received, file: Path) -> Any:
    kind = received.schema.name
    if kind not in (*_READ, _TRANSFORMS):
        raise UsageError(
            f"{file}: {received.channel.topic} has type {shortened(kind)}; it must be one of {', '.join(_READ)}, or "
            "/tf:FRAME"
        )
    try:
        return received.decoded()
    except UsageError as error:
        raise UsageError(f"{file}: {error}") from error


def _objects(kind: str, message: Any) -> Iterator[tuple[str, Any, Any, float]]:
    """Yield id (empty where the topic has one object), header, pose or point, and speed (m/s) of each object."""
    if kind.endswith("Odometry"):
        linear = message.twist.twist.linear
        yield "", message.header, message.pose.pose, math.hypot(linear.x, linear.y)
    elif kind.endswith("Detection3DArray"):
        for one in message.detections:
            id_ = one.id if hasattr(one, "id") else one.tracking_id  # before ROS 2 Humble
            yield str(id_), one.header if one.header.frame_id else message.header, one.bbox.center, math.nan
    elif kind.endswith("PointStamped"):
        yield "", message.header, message.point, math.nan
    else:
        pose = message.pose
        yield "", message.header, getattr(pose, "pose", pose), math.nan


def _place_and_heading(pose: Any) -> tuple[float, float, float, float]:
    p, q = getattr(pose, "position", pose), getattr(pose, "orientation", None)
    heading = math.nan
    if q is not None and abs(q.w**2 + q.x**2 + q.y**2 + q.z**2 - 1.0) < 1e-3:  # else it was not filled in
        heading = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y**2 + q.z**2))
    return float(p.x), float(p.y), float(p.z), heading


def _add_transforms(transforms: Transforms, message: Any, *, static: bool) -> None:
    for one in message.transforms:
        p, q = one.transform.translation, one.transform.rotation
        row = (_NANOSECONDS * from_stamp(one.header.stamp), *map(float, (p.x, p.y, p.z, q.x, q.y, q.z, q.w)))
        transforms.add(str(one.header.frame_id), str(one.child_frame_id), row, static=static)


def _track_of_frame(path: Path, name: str, transforms: Transforms, map_frame: str | None) -> Track:
    frame = name.partition(":")[2]
    if frame not in transforms.frames:
        raise UsageError(f"{path}: /tf has no frame {frame!r} but {_some(transforms)}; name it as /tf:FRAME")
    within = transforms.root(frame) if map_frame is None else _known_frame(path, transforms, map_frame)
    times = transforms.stamps(frame)
    poses = transforms.poses(frame, within, times)
    return Track(times, poses.places[:, :2], f"{path}, {name}", poses.headings, name=name, frame=within)


def _known_frame(path: Path, transforms: Transforms, frame: str) -> str:
    if not transforms.knows(frame):
        raise UsageError(
            f"{path}: --map-frame {frame}: /tf and /tf_static do not know it; they have {_some(transforms)}"
        )
    return frame


def _some(transforms: Transforms) -> str:
    return ", ".join(map(shortened, transforms.frames[:_FEW])) or "no frame"


def _track_of_rows(
    path: Path,
    name: str,
    seen: Sequence[tuple[str, tuple[float, ...]]],
    transforms: Transforms,
    map_frame: str | None,
) -> Track:
    frame, *others = dict.fromkeys(one for one, _ in seen)
    topic = name.partition(":")[0]
    if others:
        raise UsageError(f"{path}: {topic} is in two frames, {frame!r} and {others[0]!r}")
    times = np.array([row[0] for _, row in seen])
    back = np.flatnonzero(np.diff(times) < -_LATE)
    if back.size:
        before, after = times[back[0]], times[back[0] + 1]
        raise UsageError(
            f"{path}: the clock of {topic} goes back from {before:.2f} to {after:.2f} s: is it of several drives? Cut "
            "it to one"
        )
    table = np.array([row for _, row in sorted({row[:4]: (row[0], row) for _, row in seen}.values())])
    times, places, headings, speeds = table[:, 0], table[:, 1:4], table[:, 4], table[:, 5]
    if map_frame is not None and frame != map_frame:
        within = _known_frame(path, transforms, map_frame)
        turned = Rotation.from_rotvec(np.outer(np.nan_to_num(headings), [0.0, 0.0, 1.0]))
        poses = transforms.poses(frame, within, times).on(Poses(places, turned))
        places, headings, frame = poses.places, np.where(np.isnan(headings), np.nan, poses.headings), within
    return Track(times, places[:, :2], f"{path}, {name}", _complete(headings), _complete(speeds), name, frame=frame)


def _complete(values: FloatArray) -> FloatArray | None:
    return None if np.isnan(values).any() else values


# --- tables

_FURTHER = ("heading", "speed")


def table_tracks(path: Path, names: Collection[str] = ()) -> dict[str, Track]:
    """Return objects of a csv table with the columns t, id, x, y, and perhaps heading and speed, by id.

    Args:
        path: the file.
        names: ids of those to be read; empty: all that have more than one position.

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
    found = {}
    for name in names or (one for one, values in rows.items() if len(values) > 1):
        table = np.array(sorted(rows[name]), np.float64)
        said = {key: _complete(table[:, 3 + place]) for place, key in enumerate(further)}
        found[name] = Track(
            table[:, 0], table[:, 1:3], f"{path}, {name}", said.get("heading"), said.get("speed"), name=name
        )
    return found


def header_of(path: Path) -> list[str]:
    """Return the columns of a csv file."""
    return next((row for _, row in _lines(path)), [])


def csv_rows(
    path: Path, numbers: Sequence[str], texts: Sequence[str], empty: Collection[str] = ()
) -> Iterator[tuple[int, list[str], list[float]]]:
    """Yield line, texts and numbers of some columns, row by row; blank lines are left out.

    Args:
        path: the file; it may have millions of rows.
        numbers: columns of numbers.
        texts: other columns.
        empty: columns of numbers that may be empty: nan.

    Raises:
        UsageError: it cannot be read, a column is missing or there twice, or a value is no number.
    """
    lines = _lines(path)
    header = next((row for _, row in lines), [])
    for name in (*numbers, *texts):
        if header.count(name) != 1:
            raise UsageError(f"{path}, line 1: {'two columns' if name in header else 'no column'} {name!r}")
    places = {name: header.index(name) for name in (*numbers, *texts)}
    for line, row in lines:
        if not any(row):
            continue
        if len(row) <= max(places.values()) or any(row[len(header) :]):
            raise UsageError(f"{path}, line {line}: {len(row)} values where the header names {len(header)}")
        yield (
            line,
            [row[places[name]] for name in texts],
            [
                math.nan
                if name in empty and not row[places[name]]
                else finite_number(row[places[name]], f"{path}, line {line}: {name}")
                for name in numbers
            ],
        )


def _lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield number and cells of each line, the header first."""
    if path.is_dir():
        raise UsageError(f"{path}: is a folder")
    with open_regular(path) as stream:
        rows = csv.reader(io.TextIOWrapper(stream, "utf-8-sig", newline=""), strict=True)
        try:
            for row in rows:
                yield rows.line_num, [cell.strip() for cell in row]
        except csv.Error as error:
            raise UsageError(f"{path}, line {rows.line_num}: not csv: {error}") from error
        except UnicodeDecodeError as error:
            raise UsageError(f"{path}: not a text file in UTF-8") from error
