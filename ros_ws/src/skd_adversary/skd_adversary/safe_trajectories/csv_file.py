"""A safe trajectory from a plain csv file with the columns t, x, y; numeric columns of csv files."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from io import StringIO
from pathlib import Path
from typing import NamedTuple, TextIO

import numpy as np
import numpy.typing as npt
from skd_sim.arrays import FloatArray, IntArray
from skd_sim.errors import UsageError
from skd_sim.inputs.files import finite_number, is_there, read_text
from skd_sim.scenario.scenario import Scenario, check_way, start_clearance
from skd_sim.world.episode import Episode, Mode
from skd_sim.world.state import Trajectory

from skd_adversary.crossing.road_users import road_user_named


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


_COLUMNS = {"t": 1e12, "x": 1e6, "y": 1e6}


def read_csv_trajectory(path: str | Path, scenario: Scenario) -> Trajectory:
    """Read a trajectory and resample it linearly to the scenario's time step.

    The file has a header with t, x and y: s, m, m, in the world frame (x East, the crossing direction;
    y North; the lane is centred on x = 0, the crossing line is near y = 0). t may start anywhere and need not
    be uniform.

    Args:
        path: path of the csv file.
        scenario: gives time step, horizon and the car's path.

    Returns:
        The trajectory (n × 2, m), named after the file.

    Raises:
        UsageError: the file cannot be read, lacks a column, holds something that is not a finite number, has
            times that do not increase, fewer than two points, a duration under one time step or over the
            horizon, moves faster than its kind can, does not cross the car's path to the side of its destination, or
            starts where the car does.
    """
    path = Path(path)
    values, lines = read_table(path, _COLUMNS)
    return safe_trajectory(values[:, 0], values[:, 1:], scenario, path, lines)


def safe_trajectory(
    times: FloatArray, positions: FloatArray, scenario: Scenario, path: Path, lines: IntArray
) -> Trajectory:
    """Return a trajectory, checked and resampled as `read_csv_trajectory` says.

    Args:
        times: n times, s.
        positions: n × 2, m, in the world frame.
        scenario: gives time step, horizon and the car's path.
        path: file that they are from, for its name and for messages.
        lines: line of the file in which each is, for messages.

    Raises:
        UsageError: it is no safe trajectory.
    """
    if len(times) < 2:
        raise UsageError(f"{path}: {_points(len(times))}; a safe trajectory needs at least two points")
    wrong = np.flatnonzero(np.diff(times) <= 0.0)
    if len(wrong):
        before, at = wrong[0], wrong[0] + 1
        got = f"{times[at]:.15g} after {times[before]:.15g}"
        raise UsageError(f"{path}, line {lines[at]}: t must increase strictly, got {got}")
    user = road_user_named(scenario.adversary.kind)
    found = too_fast(times, positions, user.fastest)
    if found:
        raise UsageError(
            f"{path}, line {lines[found[0]]}: {found[1]}; a {user.name} moves at most {user.fastest:g} m/s: are t in "
            "s, and x and y in m, without jumps?"
        )
    duration = float(times[-1] - times[0])
    if duration > scenario.horizon:
        raise UsageError(
            f"{path}, line {lines[-1]}: lasts {duration:g} s, longer than the scenario's horizon of "
            f"{scenario.horizon:g} s"
        )
    trajectory = Trajectory(resample(times, positions, scenario.time_step), scenario.time_step, path.stem)
    if len(trajectory) < 2:
        raise UsageError(
            f"{path}, line {lines[-1]}: lasts {duration:g} s, less than one time step of "
            f"{scenario.time_step:g} s; a safe trajectory needs at least two points"
        )
    _check_path(trajectory, scenario, path)
    return trajectory


def _points(count: int) -> str:
    return "1 point" if count == 1 else f"{count} points"


def _check_path(trajectory: Trajectory, scenario: Scenario, path: Path) -> None:
    """Refuse one that never enters the car's path where it has to cross it, and one that starts inside the car."""
    crosses = scenario.adversary.destination_x is not None
    try:
        if crosses or scenario.car.meet_safe_trajectory:
            scenario.end.entry_time(trajectory)
        check_way(scenario, trajectory)
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from error
    (first, _), (last, _) = (scenario.end.place(x, y) for x, y in trajectory.positions[[0, -1]].tolist())
    eastward = scenario.end.crossing > 0.0
    if crosses and (last < first) == eastward and last != first:
        if scenario.road.straight:
            walks, towards = ("West", "East") if eastward else ("East", "West")
            raise UsageError(
                f"{path}: walks {walks}, from x = {first:.3g} to {last:.3g} m; the adversary crosses towards the "
                f"{towards}: mirror it, x to −x"
            )
        before, after = ("right", "left") if eastward else ("left", "right")
        raise UsageError(
            f"{path}: crosses the road from {before} to {after}, from {first:.3g} to {last:.3g} m to the right of its "
            f"centre line; the adversary crosses from {after} to {before}: turn the order of its points round"
        )
    episode = Episode(scenario, Mode.REPLAY, 0, 0, safe_trajectory=trajectory)
    x, y = episode.start
    if start_clearance(scenario, x, y, episode.start_gap) <= scenario.adversary.reach:
        raise UsageError(
            f"{path}: starts at ({x:g}, {y:g}) m, where the car starts, with its front "
            f"{episode.start_gap:g} m before the crossing line; a safe trajectory starts outside the car's "
            f"path, {'|x| >' if scenario.road.straight else 'off the centre line by more than'} "
            f"{scenario.path_edge:g} m"
        )
