"""Tables of trials: a row for each, with its φ, and its figures or the recording that they are measured in."""

from __future__ import annotations

import csv
from collections.abc import Callable
from io import StringIO
from pathlib import Path

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.inputs.files import did_you_mean, finite_number, read_text, real_path
from skd_sim.inputs.yaml_file import short

from skd_evaluator.extensions.fusion.figures import FIGURES, checked_value
from skd_evaluator.extensions.fusion.trial import PhysicalTrial

NAME = "trials.csv"
"""The table in a folder of trials."""
_PHI, _FILE, _GAP = "phi", "file", "gap"
_COLUMNS = (_PHI, _FILE, _GAP, *FIGURES)
_FARTHEST = 1000.0  # m that a car may start off
_SAME = 1e-3  # m that no two drives agree by at every moment: any sensor's noise is more


def table_in(path: Path) -> Path:
    """Return the table that a path names: itself, or the one in a folder.

    Raises:
        UsageError: there is none.
    """
    table = path / NAME if path.is_dir() else path
    if not table.exists():
        raise UsageError(
            f"{table}: no such file; give a table of trials with the columns phi and file, or phi and figures"
        )
    return table


def read_trials(
    path: Path, measured: Callable[[Path, PhysicalTrial], PhysicalTrial] | None = None
) -> list[PhysicalTrial]:
    """Read a table of trials, in the order of its rows.

    Args:
        path: csv file with a header: `phi`, and `file` (a recording, from the table's folder) or figures, by their
            keys; `gap` says the timing of a trial.
        measured: returns a trial with the figures that its recording shows; None: recordings cannot be measured.

    Raises:
        UsageError: the table cannot be read, a column is missing or unknown, a value is none that can be, or one
            recording is there twice.
    """
    rows = csv.DictReader(StringIO(read_text(path), newline=""), strict=True)
    try:
        header = [name.strip() for name in rows.fieldnames or []]
        _check_header(path, header, recordings=measured is not None)
        rows.fieldnames = header
        found: list[PhysicalTrial] = []
        known: dict[Path, PhysicalTrial] = {}
        for row in rows:
            where = f"{path}, line {rows.line_num}"
            if None in row or None in row.values():
                raise UsageError(f"{where}: has another number of values than the header")
            row = {name: value.strip() for name, value in row.items()}
            found.append(_trial(path, where, row, measured))
            if row.get(_FILE):
                _check_once(known, path.parent / row[_FILE], found[-1])
    except csv.Error as error:
        raise UsageError(f"{path}, line {rows.line_num}: not csv: {error}") from error
    if not found:
        raise UsageError(f"{path}: has no trial")
    return found


def _check_header(path: Path, header: list[str], *, recordings: bool) -> None:
    for name in header:
        if name not in _COLUMNS:
            raise UsageError(
                f"{path}, line 1: unknown column {name!r}{did_you_mean(name, _COLUMNS)}; there are "
                f"{', '.join(_COLUMNS)}"
            )
    if len(set(header)) < len(header):
        raise UsageError(f"{path}, line 1: a column stands twice")
    if _PHI not in header:
        raise UsageError(f"{path}, line 1: no column 'phi', which says on which φ each trial was")
    if not set(header) & {_FILE, *FIGURES}:
        raise UsageError(f"{path}, line 1: neither a column 'file' nor one of {', '.join(FIGURES)}")
    if _FILE in header and not recordings:
        raise UsageError(
            f"{path}, line 1: recordings cannot be measured without road and shapes: SIMULATED must be the folder of "
            "an assessment, or the table must hold figures"
        )


def _check_once(known: dict[Path, PhysicalTrial], file: Path, trial: PhysicalTrial) -> None:
    """Refuse a recording that was there before, by its file or, of a copy, by its tracks: it would count twice."""
    path = real_path(file)
    before = known.get(path) or next((one for one in known.values() if _same_track(one, trial)), None)
    if before is not None:
        raise UsageError(f"{trial.where}: is the recording of {before.where} once more; give each trial its own")
    known[path] = trial


def _same_track(one: PhysicalTrial, other: PhysicalTrial) -> bool:
    """Return whether two trials are of one drive; one of the recordings may end earlier."""
    if one.track is None or other.track is None:
        return False
    count = min(len(one.track), len(other.track))
    return bool(np.abs(one.track[:count] - other.track[:count]).max() < _SAME)


def _trial(
    path: Path, where: str, row: dict[str, str], measured: Callable[[Path, PhysicalTrial], PhysicalTrial] | None
) -> PhysicalTrial:
    if not row[_PHI]:
        raise UsageError(f"{where}: phi is empty")
    values = {
        key: checked_value(figure, finite_number(row[key], f"{where}: {key}"), where)
        for key, figure in FIGURES.items()
        if row.get(key)
    }
    if values.get("hit") == 1.0 and values.get("clearance", 0.0) > 0.0:
        raise UsageError(f"{where}: the car hit, and its clearance is {values['clearance']:g} m; it must be 0")
    gap = finite_number(row[_GAP], f"{where}: gap") if row.get(_GAP) else None
    if gap is not None and not 0.0 <= gap <= _FARTHEST:
        raise UsageError(f"{where}: gap must be from 0 to {_FARTHEST:g} m, got {gap:g}")
    trial = PhysicalTrial(row[_PHI], values, gap, where)
    if row.get(_FILE):
        if "\0" in row[_FILE]:
            raise UsageError(f"{where}: file must be the path of a recording, got {short(row[_FILE])}")
        assert measured is not None
        return measured(path.parent / row[_FILE], trial)
    if not values:
        raise UsageError(f"{where}: has neither a file nor a figure")
    return trial
