"""The two tracked objects of a recording: an MCAP file or a bag's folder, or a csv table; by topic, or by id."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.inputs.numbers import finite_number
from skd_sim.inputs.outside import read_text
from skd_sim.messages.from_messages import from_stamp

from skd_evaluator.bags.inventory import find_recordings
from skd_evaluator.bags.mcap_file import Condition, read_messages
from skd_evaluator.bags.recording import ADVERSARY, CAR, shortened
from skd_evaluator.bags.types import typestore
from skd_evaluator.fusion.track import Track

TABLE_CAR, TABLE_OTHER = "car", "other"
"""Ids of the two in a table, where nothing else is said."""
_COLUMNS = ("t", "id", "x", "y")
_FURTHER = ("heading", "speed")
_NANOSECONDS = 1e-9


class Row(NamedTuple):
    """A position: s, m, m, and where they are said heading (rad) and speed (m/s); else nan."""

    time: float
    x: float
    y: float
    heading: float
    speed: float


def _odometry(message: Any) -> tuple[float, ...]:
    linear = message.twist.twist.linear
    return (*_pose(message.pose.pose), float(np.hypot(linear.x, linear.y)))


def _pose(pose: Any) -> tuple[float, float, float]:
    q = pose.orientation
    heading = np.arctan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y**2 + q.z**2))
    said = abs(q.w**2 + q.x**2 + q.y**2 + q.z**2 - 1.0) < 1e-3  # else nobody filled it in
    return float(pose.position.x), float(pose.position.y), float(heading) if said else np.nan


_READERS: dict[str, Callable[[Any], tuple[float, ...]]] = {
    "nav_msgs/msg/Odometry": _odometry,
    "geometry_msgs/msg/PoseStamped": lambda message: (*_pose(message.pose), np.nan),
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda message: (*_pose(message.pose.pose), np.nan),
    "geometry_msgs/msg/PointStamped": lambda message: (float(message.point.x), float(message.point.y), np.nan, np.nan),
}


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


def _track(rows: list[Row], where: str) -> Track:
    values = np.array(sorted(dict.fromkeys(rows)), np.float64).reshape(-1, 5)
    said: list[FloatArray | None] = [None if np.isnan(column).any() else column for column in values[:, 3:].T]
    return Track(values[:, 0], values[:, 1:3], said[0], said[1], where).checked()


def _rows_of_bag(path: Path, topics: tuple[str, str]) -> dict[str, list[Row]]:
    rows: dict[str, list[Row]] = {topic: [] for topic in topics}
    frames: dict[str, str] = {}
    for file in (file for files in find_recordings([path]) for file in files):
        condition = Condition()
        for received in read_messages(file, lambda topic: topic in rows, condition):
            topic, kind = received.channel.topic, received.schema.name
            if kind not in _READERS:
                raise UsageError(f"{file}: {topic} has type {shortened(kind)}; it must be one of {', '.join(_READERS)}")
            try:
                message: Any = typestore().deserialize_cdr(received.data, kind)
            except Exception as error:  # what damaged bytes are taken for can raise anything
                raise UsageError(f"{file}: a message on {topic} cannot be read ({shortened(str(error))})") from error
            frames.setdefault(topic, str(message.header.frame_id))
            if frames[topic] != message.header.frame_id:
                raise UsageError(f"{file}: {topic} is in two frames, {frames[topic]!r} and {message.header.frame_id!r}")
            rows[topic].append(Row(_NANOSECONDS * from_stamp(message.header.stamp), *_READERS[kind](message)))
        if condition.damage:
            raise UsageError(f"{file}: is damaged ({condition.damage[0]})")
    for topic in topics:
        if not rows[topic]:
            raise UsageError(f"{path}: has no message on {topic}; name the topics by --car and --road-user")
    _check_frames(path, frames, topics)
    return rows


def _check_frames(path: Path, frames: dict[str, str], topics: tuple[str, str]) -> None:
    if len({*frames.values()}) > 1:
        said = " and ".join(f"{topic} in {frames[topic]!r}" for topic in topics)
        raise UsageError(f"{path}: {said}: two frames, and nothing says how they lie; record both in one")


def _rows_of_table(path: Path, ids: tuple[str, str]) -> dict[str, list[Row]]:
    rows: dict[str, list[Row]] = {name: [] for name in ids}
    known: set[str] = set()
    try:
        for line, row in _lines(path):
            known.add(row["id"])
            if row["id"] in rows:
                values = (
                    _number(row.get(name, ""), f"{path}, line {line}: {name}", name) for name in (*"txy", *_FURTHER)
                )
                rows[row["id"]].append(Row(*values))
    except csv.Error as error:
        raise UsageError(f"{path}: not csv: {error}") from error
    for name in ids:
        if not rows[name]:
            raise UsageError(
                f"{path}: has no object {name!r} but {', '.join(sorted(known)[:5]) or 'none'}; name them by --car and "
                "--road-user"
            )
    return rows


def _lines(path: Path) -> Iterator[tuple[int, dict[str, str]]]:
    table = csv.DictReader(StringIO(read_text(path), newline=""), strict=True)
    table.fieldnames = [name.strip() for name in table.fieldnames or []]
    for name in _COLUMNS:
        if name not in table.fieldnames:
            raise UsageError(f"{path}, line 1: no column {name!r}; a table of tracks has t, id, x, y[, heading, speed]")
    for row in table:
        if None in row or None in row.values():
            raise UsageError(f"{path}, line {table.line_num}: has another number of values than the header")
        yield table.line_num, {name: value.strip() for name, value in row.items()}


def _number(text: str, what: str, name: str) -> float:
    if not text and name in _FURTHER:
        return float("nan")
    return finite_number(text, what)
