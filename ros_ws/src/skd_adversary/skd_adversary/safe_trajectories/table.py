"""Numeric columns of a csv file, with errors that name file and line."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from io import StringIO
from pathlib import Path
from typing import NamedTuple, TextIO

import numpy as np
import numpy.typing as npt
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.inputs.files import finite_number, is_there, read_text

_MOST = 1_000_000
"""Rows of a file, each of which takes some two hundred bytes of memory."""


class Table(NamedTuple):
    """Rows of a csv file: values (rows × columns, in the order asked for) and the line number of each row."""

    values: FloatArray
    lines: npt.NDArray[np.int64]


def read_table(path: Path, columns: Mapping[str, float]) -> Table:
    """Read numeric columns of a csv file with a header; other columns and blank lines are ignored.

    Args:
        path: the file; UTF-8, with or without a byte-order mark.
        columns: name → greatest magnitude allowed, in the column's unit.

    Raises:
        UsageError: file missing or unreadable, a column missing or there twice, a row too short or too long, or a value
            that is not a number, not finite or out of range.
    """
    if not is_there(path):
        raise UsageError(f"{path}: cannot be read: No such file or directory")
    if path.is_dir():
        raise UsageError(f"{path}: cannot be read: Is a directory")
    return _parse(StringIO(read_text(path), newline=""), path, columns)


def _parse(file: TextIO, path: Path, columns: Mapping[str, float]) -> Table:
    rows = csv.reader(file)
    wanted = ",".join(columns)
    values: list[list[float]] = []
    lines: list[int] = []
    try:
        header = [name.strip() for name in next(rows, [])]
        for name in columns:
            if name not in header:
                got = " ".join(",".join(header).split())[:200] or "an empty line"
                raise UsageError(f"{path}, line 1: no column {name!r}; the header must name {wanted}, got {got}")
            if header.count(name) > 1:
                raise UsageError(f"{path}, line 1: two columns {name!r}")
        places = [header.index(name) for name in columns]
        for row in rows:
            if not any(cell.strip() for cell in row):
                continue
            where = f"{path}, line {rows.line_num}"
            if len(row) <= max(places) or any(cell.strip() for cell in row[len(header) :]):
                raise UsageError(f"{where}: {len(row)} values where the header names {len(header)}")
            values.append(
                [
                    _number(row[place].strip(), f"{where}: {name}", limit)
                    for place, (name, limit) in zip(places, columns.items(), strict=True)
                ]
            )
            lines.append(rows.line_num)
            if len(lines) > _MOST:
                raise UsageError(f"{where}: more than {_MOST} rows, which no trajectory has")
    except csv.Error as error:
        raise UsageError(f"{path}, line {rows.line_num}: not csv: {error}") from error
    return Table(np.array(values, np.float64).reshape(-1, len(columns)), np.array(lines, np.int64))


def _number(text: str, what: str, limit: float) -> float:
    value = finite_number(text, what)
    if abs(value) > limit:
        raise UsageError(f"{what} must lie within ±{limit:g}, got {text[:40]}")
    return value


_JITTER = 0.05
"""m that a sensor may be off from one row to the next: at many rows a second that is no speed."""


def too_fast(times: FloatArray, positions: FloatArray, fastest: float) -> tuple[int, str] | None:
    """Return the first row to which somebody moves faster than can be, and how; none where there is none.

    Args:
        times: n times, s, strictly increasing.
        positions: n × 2 positions, m.
        fastest: m/s, that can be.
    """
    moved = np.hypot(*np.diff(positions, axis=0).T)
    passed = np.diff(times)
    wrong = np.flatnonzero(moved > fastest * passed + _JITTER)
    if not len(wrong):
        return None
    row = int(wrong[0])
    metres, seconds = float(moved[row]), float(passed[row])  # of Python's: their quotient may be infinite
    return row + 1, f"moves {metres:.3g} m in {seconds:.3g} s ({metres / seconds:.3g} m/s)"


def resample(times: FloatArray, positions: FloatArray, time_step: float) -> FloatArray:
    """Interpolate positions linearly at times[0] + k·time_step, up to the last time.

    What is left after the last whole time step is dropped, for a trajectory is uniform in time.

    Args:
        times: n times, s, strictly increasing.
        positions: n × d positions, m.
        time_step: duration of a tick, s.

    Returns:
        m × d positions, m ≥ 1.
    """
    # The tolerance keeps the last sample of data already at the time step, whatever its rounding.
    count = int((times[-1] - times[0]) / time_step + 1e-6) + 1
    at = np.minimum(times[0] + time_step * np.arange(count), times[-1])
    return np.column_stack([np.interp(at, times, positions[:, axis]) for axis in range(positions.shape[1])])
