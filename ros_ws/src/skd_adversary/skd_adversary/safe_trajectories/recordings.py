"""Recorded road users: tables of csv files, checks of what cannot have been, resampling, and the frame of a car."""

from __future__ import annotations

import csv
import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from io import TextIOWrapper
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from skd_sim.errors import UsageError
from skd_sim.inputs.files import finite_number, open_regular
from skd_sim.inputs.yaml_file import short
from skd_sim.world.state import FloatArray, IntArray

LONGEST_HOLE: Final = 0.6
"""s without a row, up to which a straight line says where a pedestrian was."""
_LEAP: Final = 0.5
"""m by which a row may be off what the velocities before and at it give; filtered tracks of CITR are 0.17 m off."""
_LEAST_LENGTH: Final = 2.0
"""m, from which on a path shows in which units and which direction it is."""
_LEAST_POSITIONS: Final = 3
"""Positions at the least by which tracks are compared."""
_JITTER = 0.05
"""m that a sensor may be off from one row to the next: at many rows a second that is no speed."""


def read_table(path: Path, columns: Mapping[str, float]) -> tuple[FloatArray, IntArray]:
    """Return numeric columns of a csv file with a header, rows × columns as requested, and the line of each row.

    Other columns and blank lines are ignored.

    Args:
        path: the file; UTF-8, with or without a byte-order mark.
        columns: name → greatest magnitude allowed, in the column's unit.

    Raises:
        UsageError: as `csv_rows`, or a value is out of range.
    """
    rows = list(csv_rows(path, tuple(columns)))
    values = np.array([row for _, _, row in rows], np.float64).reshape(-1, len(columns))
    lines = np.array([line for line, _, _ in rows], np.int64)
    for row, place in np.argwhere(np.abs(values) > list(columns.values())).tolist():
        name = list(columns)[place]
        got = f"{name} must lie within ±{columns[name]:g}, got {values[row, place]:g}"
        raise UsageError(f"{path}, line {lines[row]}: {got}")
    return values, lines


def header_of(path: Path) -> list[str]:
    """Return the columns of a csv file."""
    return next((row for _, row in _lines(path)), [])


def csv_rows(
    path: Path, numbers: Sequence[str], texts: Sequence[str] = (), empty: Collection[str] = ()
) -> Iterator[tuple[int, list[str], list[float]]]:
    """Yield line, texts and numbers of some columns, row by row; blank lines are left out.

    Args:
        path: the file; it may have millions of rows.
        numbers: columns of numbers.
        texts: other columns.
        empty: columns of numbers that may be empty: nan.

    Raises:
        UsageError: it cannot be read, a column is missing or there twice, a row is too short or too long, or a value is
            no finite number.
    """
    lines = _lines(path)
    header = next((row for _, row in lines), [])
    for name in (*numbers, *texts):
        if header.count(name) != 1:
            what = "two columns" if name in header else "no column"
            needed = f"the header must name {','.join((*numbers, *texts))}, got {short(','.join(header))}"
            raise UsageError(f"{path}, line 1: {what} {name!r}; {needed}")
    places = {name: header.index(name) for name in (*numbers, *texts)}
    for line, row in lines:
        if not any(row):
            continue
        where = f"{path}, line {line}"
        if len(row) <= max(places.values()) or any(row[len(header) :]):
            raise UsageError(f"{where}: {len(row)} values where the header names {len(header)}")
        cells = {name: row[place] for name, place in places.items()}
        values = [
            math.nan if name in empty and not cells[name] else finite_number(cells[name], f"{where}: {name}")
            for name in numbers
        ]
        yield line, [cells[name] for name in texts], values


def _lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield number and cells of each line, the header first."""
    with open_regular(path) as stream:
        rows = csv.reader(TextIOWrapper(stream, "utf-8-sig", newline=""), strict=True)
        try:
            for row in rows:
                yield rows.line_num, [cell.strip() for cell in row]
        except csv.Error as error:
            raise UsageError(f"{path}, line {rows.line_num}: not csv: {error}") from error
        except UnicodeDecodeError as error:
            raise UsageError(f"{path}: not a text file in UTF-8") from error


def write_trajectory(path: Path, times: FloatArray, positions: FloatArray) -> None:
    """Write times (s) and positions (n × 2, m) as csv that `--safe` reads; numbers come back to the last bit."""
    rows = zip(times.tolist(), positions.tolist(), strict=True)
    path.write_text("t,x,y\n" + "".join(f"{time!r},{x!r},{y!r}\n" for time, (x, y) in rows), encoding="utf-8")


def interpolated(at: npt.NDArray[np.floating], times: npt.NDArray[np.floating], values: FloatArray) -> FloatArray:
    """Return values (n × d, known at n times, s) at other times, m × d: in straight lines, column by column."""
    return np.column_stack([np.interp(at, times, column) for column in values.T])


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
    return interpolated(at, times, positions)


def too_fast(times: FloatArray, positions: FloatArray, fastest: float) -> tuple[int, str] | None:
    """Return the first row that is reached at an impossible speed, and why; None where there is none.

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


def check_motion(
    times: FloatArray, positions: FloatArray, velocities: FloatArray, lines: IntArray, where: Path, share: float
) -> None:
    """Refuse a track that leaps, has a hole, or whose stated velocities are not those of its positions.

    Args:
        times: n, s, strictly increasing.
        positions: n × 2, m.
        velocities: n × 2, m/s, as the recording states them.
        lines: of the file, of each row.
        where: the file, for messages.
        share: of the longer path, by positions or velocities, by which the two may differ.

    Raises:
        UsageError: it is so.
    """
    passed = np.diff(times)
    if not len(passed):
        return
    hole = int(np.argmax(passed))
    if passed[hole] > LONGEST_HOLE:
        raise UsageError(f"{where}, line {lines[hole + 1]}: {passed[hole]:.3g} s after the row before; cut it there")
    moved, stated = np.diff(positions, axis=0), 0.5 * (velocities[1:] + velocities[:-1]) * passed[:, None]
    off = np.hypot(*(moved - stated).T)
    if off.max() > _LEAP:
        leap = int(np.argmax(off > _LEAP))
        way, due = (f"{float(np.hypot(*one[leap])):.3g} m" for one in (moved, stated))
        raise UsageError(f"{where}, line {lines[leap + 1]}: moves {way} in a row, and {due} by its velocities")
    went, said = moved.sum(axis=0), stated.sum(axis=0)
    longer = max(float(np.hypot(*went)), float(np.hypot(*said)))
    if longer > _LEAST_LENGTH and float(np.hypot(*(went - said))) > share * longer:
        ways = f"({went[0]:.3g}, {went[1]:.3g}) m, and their velocities ({said[0]:.3g}, {said[1]:.3g}) m"
        raise UsageError(f"{where}, line {lines[0]}: the positions from here on go {ways}: check units and frame rate")


def check_once(paths: Iterable[tuple[str, FloatArray]], *, moved: bool = True) -> None:
    """Refuse a path that is there twice: one person would count as two.

    Args:
        paths: name (file, or recording and id) and positions (n × 2, m) of each.
        moved: also the same path from another place. No two people who were tracked go the same path, others may.

    Raises:
        UsageError: two are the same to a hundredth of a millimetre.
    """
    named = list(paths)
    for second, first in repeated([positions for _, positions in named], moved=moved):
        raise UsageError(f"{named[second][0]}: {duplicate_of(named[first][0])}; leave one of them out")


def repeated(paths: Sequence[FloatArray], *, moved: bool) -> Iterator[tuple[int, int]]:
    """Yield the index of each path (n × 2, m) that is there once more, and that of the first that it is the same as.

    Args:
        paths: positions of each; with a third column, that is compared as well.
        moved: also the same path from another place.
    """
    known: dict[bytes, int] = {}
    for index, positions in enumerate(paths):
        if len(positions) < _LEAST_POSITIONS:
            continue
        key = (np.round(positions - positions[0] * moved, 5) + 0.0).tobytes()  # + 0: −0 is 0
        first = known.setdefault(key, index)
        if first != index:
            yield index, first


def duplicate_of(name: str) -> str:
    """Return what is said of the path that is that of `name` once more."""
    return f"is the trajectory of {name} once more, and would count twice"


class CarFrameTrack(NamedTuple):
    """A path as it is seen from the car's.

    Attributes:
        positions: n × 2 (East, North), m.
        mirrored: whether East and West were exchanged, so that it goes East.
        aside: how far the car was off its straight line at most, m.
    """

    positions: FloatArray
    mirrored: bool
    aside: float


def in_car_frame(car: FloatArray, path: FloatArray) -> CarFrameTrack:
    """Return a recorded path in the world frame.

    Rotated so that the car drives North: its direction and x = 0 are those of the straight line fitted to its positions
    (total least squares). Mirrored, if need be, so that the path goes East. y = 0 is where it crosses x = 0 for the
    first time (linear interpolation), or its first point where it does not.

    Args:
        car: k × 2 positions of the car, m, which are not all the same.
        path: n × 2 positions of the road user, m, in the same frame.
    """
    centre = car.mean(axis=0)
    direction = np.linalg.svd(car - centre, full_matrices=False)[2][0]
    if direction @ (car[-1] - car[0]) < 0.0:
        direction = -direction
    across = np.array([direction[1], -direction[0]])
    offset = path - centre
    north = offset @ direction
    east = offset @ across
    mirrored = bool(east[-1] < east[0])
    if mirrored:
        east = -east
    after = np.flatnonzero((east[:-1] < 0.0) & (east[1:] >= 0.0))
    origin = north[0]
    if len(after):
        i = int(after[0])
        origin = north[i] + (north[i + 1] - north[i]) * east[i] / (east[i] - east[i + 1])
    aside = float(np.abs((car - centre) @ across).max())
    return CarFrameTrack(np.column_stack([east, north - origin]), mirrored, aside)
