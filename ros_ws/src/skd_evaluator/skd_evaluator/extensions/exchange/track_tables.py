"""Tracks in csv: t, x, y; tables of tracked objects (t, id, x, y); recordings in the layout of inD and rounD.

The layout of the data sets of levelXdata (inD: Bock et al. 2020, rounD: Krajewski et al. 2020): NN_tracks.csv with
trackId, frame, xCenter, yCenter (m) for each object and frame, NN_tracksMeta.csv with the class of each track, and
NN_recordingMeta.csv with frameRate (1/s). Such files have millions of rows, so they are read row by row, and only the
requested tracks are kept.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.inputs.files import finite_number, is_there, open_regular
from skd_sim.scenario.road_user import ROAD_USERS

from skd_evaluator.extensions.exchange.tracks import TrackedObject, listed, track_of

_TRACKS, _META, _RECORDING = "_tracks.csv", "_tracksMeta.csv", "_recordingMeta.csv"
_LEVELX = "levelxdata"
"""Whose words for kinds these are (`called` of a kind of road user)."""
_TIMED, _NAMED, _FRAMED = ("t", "x", "y"), ("t", "id", "x", "y"), ("trackId", "frame", "xCenter", "yCenter")
_Kept = dict[str, list[tuple[float, float, float]]]


def is_of_tracks(path: Path) -> bool:
    """Return whether a file is named as the tracks of a recording of levelXdata are."""
    return path.name.endswith(_TRACKS)


def is_beside_tracks(path: Path) -> bool:
    """Return whether a file only says what is in another one."""
    return path.name.endswith((_META, _RECORDING))


def read_table(path: Path, names: Collection[str], kind: str) -> tuple[list[TrackedObject], str]:
    """Return the objects of a csv file, and what it is.

    Args:
        path: the file.
        names: only these are kept, where there are any.
        kind: kind of road user that is wanted; only levelXdata say of which kind a track is.

    Raises:
        UsageError: it cannot be read, has another layout, a value that is no number, or frames that do not increase.
    """
    header = _header(path)
    if set(_FRAMED) <= set(header):
        return _levelx(path, names, kind), "tracks in the layout of inD and rounD"
    if set(_NAMED) <= set(header):
        return _objects(path, names), "a table of tracked objects"
    if set(_TIMED) <= set(header):
        rows = [(time, x, y) for _, (time, x, y) in _rows(path, _TIMED, ())]
        return [_found(path, path.stem, rows)], "a way (t, x, y)"
    raise UsageError(
        f"{path}, line 1: the header must name {','.join(_TIMED)} or {','.join(_NAMED)} or {','.join(_FRAMED)}, got "
        f"{' '.join(','.join(header).split())[:160] or 'nothing'}"
    )


def _objects(path: Path, names: Collection[str]) -> list[TrackedObject]:
    kept: _Kept = {}
    others: dict[str, None] = {}
    for (name,), (time, x, y) in _rows(path, _TIMED, ("id",)):
        if not names or name in names:
            kept.setdefault(name, []).append((time, x, y))
        elif len(others) < 100:
            others[name] = None
    if not kept:
        raise UsageError(f"{path}: has no object {listed(sorted(names))}; it has {listed(list(others))}")
    return [_found(path, name, rows) for name, rows in kept.items() if len(rows) > 1]


def _levelx(path: Path, names: Collection[str], kind: str) -> list[TrackedObject]:
    rate, classes = _rate(path), _classes(path)
    wanted = set(names)
    if not wanted:
        word = ROAD_USERS.find(kind).names.get(_LEVELX)
        if word is None:
            raise UsageError(f"--kind {kind}: inD and rounD have no class for it")
        wanted = {name for name, one in classes.items() if one == word}
        if not wanted:
            raise UsageError(f"{path}: has no {word}; it has {listed(sorted(set(classes.values())))}")
    elif missing := sorted(wanted - set(classes)):
        raise UsageError(f"{path}: has no track {listed(missing)}; its tracks are {listed(list(classes))}")
    kept: _Kept = {}
    for (name,), (frame, x, y) in _rows(path, ("frame", "xCenter", "yCenter"), ("trackId",)):
        if name in wanted:
            kept.setdefault(name, []).append((frame / rate, x, y))
    found = [_found(path, name, rows, classes[name]) for name, rows in kept.items() if len(rows) > 1]
    if not found:
        raise UsageError(f"{path}: has no row of track {listed(sorted(wanted))}")
    return found


def _rate(path: Path) -> float:
    """Return the frames per second of a recording."""
    beside = _beside(path, _RECORDING)
    for _, (rate,) in _rows(beside, ("frameRate",), ()):
        if not 0.1 <= rate <= 1000.0:
            raise UsageError(f"{beside}: frameRate must be from 0.1 to 1000 1/s, got {rate:g}")
        return rate
    raise UsageError(f"{beside}: has no row")


def _classes(path: Path) -> Mapping[str, str]:
    """Return the class of each track, by its id."""
    beside, found = _beside(path, _META), dict[str, str]()
    for (name, kind), _ in _rows(beside, (), ("trackId", "class")):
        if found.setdefault(name, kind) != kind:
            raise UsageError(f"{beside}: track {listed([name])} has two classes")
    return found


def _beside(path: Path, ending: str) -> Path:
    if not is_of_tracks(path):
        raise UsageError(f"{path}: has columns of inD and rounD, whose files are called NN{_TRACKS}; give it that name")
    found = path.with_name(path.name.removesuffix(_TRACKS) + ending)
    if not is_there(found):
        raise UsageError(
            f"{path}: {found.name}, which says {'classes' if ending == _META else 'the rate'}, is not beside it"
        )
    return found


def _found(path: Path, name: str, rows: Sequence[tuple[float, float, float]], kind: str = "") -> TrackedObject:
    table = np.array(rows, np.float64).reshape(-1, 3)
    return TrackedObject(name, track_of(table[:, 0], table[:, 1:], f"{path}, {name}"), kind)


def _header(path: Path) -> list[str]:
    return next((row for _, row in _lines(path)), [])


def _rows(path: Path, numbers: Sequence[str], texts: Sequence[str]) -> Iterator[tuple[list[str], list[float]]]:
    """Yield the texts and the numbers of some columns, row by row; blank lines are left out."""
    lines = _lines(path)
    header = next((row for _, row in lines), [])
    for name in (*numbers, *texts):
        if header.count(name) != 1:
            raise UsageError(f"{path}, line 1: {'two columns' if name in header else 'no column'} {name!r}")
    number_places, text_places = [header.index(name) for name in numbers], [header.index(name) for name in texts]
    least = max([*number_places, *text_places]) + 1
    for line, row in lines:
        if not any(row):
            continue
        if len(row) < least or any(row[len(header) :]):
            raise UsageError(f"{path}, line {line}: {len(row)} values where the header names {len(header)}")
        values = [
            finite_number(row[place], f"{path}, line {line}: {name}")
            for place, name in zip(number_places, numbers, strict=True)
        ]
        yield [row[place] for place in text_places], values


def _lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield number and cells of each line, the header first."""
    if path.is_dir():
        raise UsageError(f"{path}: is a folder")
    with open_regular(path) as stream:
        text = io.TextIOWrapper(stream, "utf-8-sig", newline="")
        rows = csv.reader(text, strict=True)
        try:
            for row in rows:
                yield rows.line_num, [cell.strip() for cell in row]
        except csv.Error as error:
            raise UsageError(f"{path}, line {rows.line_num}: not csv: {error}") from error
        except UnicodeDecodeError as error:
            raise UsageError(f"{path}: not a text file in UTF-8") from error
