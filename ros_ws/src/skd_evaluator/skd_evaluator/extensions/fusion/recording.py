"""The two tracked objects of a recording: an MCAP file or a bag's folder, or a csv table; by topic, or by id."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from io import StringIO
from pathlib import Path

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.inputs.files import finite_number, read_text
from skd_sim.inputs.yaml_file import short

from skd_evaluator.bags.read import ADVERSARY, CAR
from skd_evaluator.extensions.fusion.bag_tracks import Row, bag_tracks
from skd_evaluator.extensions.fusion.track import Track

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


def _track(rows: list[Row], where: str) -> Track:
    values = np.array(sorted(dict.fromkeys(rows)), np.float64).reshape(-1, 5)
    said: list[FloatArray | None] = [None if np.isnan(column).any() else column for column in values[:, 3:].T]
    return Track(values[:, 0], values[:, 1:3], said[0], said[1], where).checked()


def _rows_of_bag(path: Path, names: tuple[str, str]) -> dict[str, list[Row]]:
    found = bag_tracks(path, names)
    _check_frames(path, {name: one.frame for name, one in found.items()}, names)
    return {name: one.rows for name, one in found.items()}


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
