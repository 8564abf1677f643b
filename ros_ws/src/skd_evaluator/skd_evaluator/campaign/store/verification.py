"""Whether the folder of a result is what was written, and whether what it says follows from what it holds."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skd_sim.errors import UsageError
from skd_sim.inputs.outside import folders_in, read_json, read_text, sha256_of

from skd_evaluator.campaign.judge.figure_table import AT_THE_TOP, Told
from skd_evaluator.campaign.judge.surrogate_figures import SURROGATES, Surrogates
from skd_evaluator.campaign.store.checked import starts_that_differ
from skd_evaluator.campaign.store.manifest import MANIFEST, Held, hold, read_manifest
from skd_evaluator.campaign.store.rebuilt import BEHAVIOUR, BUDGETS, can_be_rebuilt, recompute
from skd_evaluator.campaign.store.result_file import ASSESSMENT, read_figures, understood
from skd_evaluator.campaign.store.stored_episodes import EPISODES, StoredEpisodes, read_episodes
from skd_evaluator.measure.aborted import aborted_lines
from skd_evaluator.measure.credibility import not_credible

_CAMPAIGN, _CELLS, _TABLE, _SWEEP = "campaign.json", "cells.json", "campaign.csv", "sweep.json"
_AGREE = 1e-7
"""Relative to a value in a CSV, or to 1: rounding of another machine, and of nine digits."""


@dataclass(frozen=True)
class Verified:
    """What was found out about a folder.

    Attributes:
        folder: folder that was looked at.
        files: comparison of its files with its manifest; None if it has no manifest.
        agree: names of figures that follow from its episodes.
        contradict: figures that do not, a line each.
        unknown: names of figures that cannot be recomputed from the folder, by the reason.
        problems: whatever else is wrong, a line each.
        remarks: remarks for the reader, a line each.
        read: its figures, whether they are of before the margin, and its episodes, for whoever looks at them further;
            None if they could not be read.
    """

    folder: Path
    files: Held | None
    agree: tuple[str, ...] = ()
    contradict: tuple[str, ...] = ()
    unknown: Mapping[str, tuple[str, ...]] | None = None
    problems: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    read: tuple[Mapping[str, Any], StoredEpisodes] | None = None

    @property
    def fine(self) -> bool:
        """Whether nothing was found that speaks against the folder."""
        files = self.files
        return not (self.contradict or self.problems or (files is not None and (files.changed or files.missing)))

    def as_dict(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        files = self.files
        parts = ("same", "changed", "missing", "others")
        return {
            "folder": str(self.folder),
            "fine": self.fine,
            "files": None if files is None else {name: list(getattr(files, name)) for name in parts},
            "agree": list(self.agree),
            "contradict": list(self.contradict),
            "unknown": {reason: list(names) for reason, names in (self.unknown or {}).items()},
            "problems": list(self.problems),
            "remarks": list(self.remarks),
        }


def folders_below(folder: Path) -> list[Path]:
    """Return the folders of results at and below one, itself first; links are not followed.

    Raises:
        UsageError: there is none.
    """
    if not folder.is_dir():
        raise UsageError(f"{folder}: no such folder; give that of a result")
    inside: set[Path] = set()
    for path, *names in folders_in(folder, lambda path, _: inside.add(path)):  # of which `verify` says so
        here = {name for some in names for name in some}
        if ASSESSMENT in here or MANIFEST in here or (path == folder and _CAMPAIGN in here):
            inside.add(path)
    found = sorted(inside)
    if not found:
        raise UsageError(f"{folder}: holds no {ASSESSMENT} and no {MANIFEST}; give the folder of a result")
    return found


def verify(folder: Path) -> Verified:
    """Return what is to be said of a folder, whatever is wrong with it.

    Args:
        folder: the folder of a result.
    """
    try:
        there = {path.name for path in folder.iterdir()}
    except OSError as error:
        return Verified(folder, None, problems=(f"{folder}: cannot be looked into ({error.strerror})",))
    problems: list[str] = []
    files = None
    try:
        manifest = read_manifest(folder)
        files = None if manifest is None else hold(folder, manifest)
    except UsageError as error:
        problems.append(str(error))
    remarks: list[str] = []
    if _CAMPAIGN in there:
        problems += _rows_that_differ(folder)
    elif files is None and not problems:
        remarks.append(f"no {MANIFEST}: of an older version, or it was removed; that a file was changed cannot be told")
    if _SWEEP in there and ASSESSMENT not in there:
        problems += _sweep_that_differs(folder)
    named = files is not None and ASSESSMENT in (*files.same, *files.changed, *files.missing)
    if not named and ASSESSMENT not in there:
        return Verified(folder, files, problems=tuple(problems), remarks=tuple(remarks))
    try:
        figures = read_figures(folder)
        stored = read_episodes(folder)
        remarks += not_credible(figures.get("warnings") or ())
        if not can_be_rebuilt(stored):
            remarks.append(f"{EPISODES} is of an older version: its figures cannot be recomputed")
            read = figures, stored
            return Verified(folder, files, problems=tuple(problems), remarks=tuple(remarks), read=read)
        with understood(folder / ASSESSMENT):
            found = recompute(figures, stored)
            remarks += aborted_lines(found.figures)
            starts = starts_that_differ(folder, figures, stored)
            if starts is not None:
                (problems if starts.refused else remarks).append(starts.line)
            if (folder / SURROGATES).exists():  # older results have none
                problems += _surrogates_that_differ(folder / SURROGATES, found.rating.surrogates)
    except UsageError as error:
        return Verified(folder, files, problems=(*problems, str(error)), remarks=tuple(remarks))
    unknown: dict[str, tuple[str, ...]] = {}
    for name in dict.fromkeys(_figure(name) for name in found.unknown):
        reason = _why_unknown(name)
        unknown[reason] = (*unknown.get(reason, ()), name)
    return Verified(
        folder,
        files,
        found.agree,
        tuple(map(str, found.contradict)),
        unknown,
        tuple(problems),
        tuple(remarks),
        read=(figures, stored),
    )


def _figure(name: str) -> str:
    """Return an entry's name without what is inside of it."""
    inside = next((one for one in (BUDGETS, BEHAVIOUR) if name.startswith(one)), None)
    return inside or name.partition(".")[0]


def _why_unknown(name: str) -> str:
    if name == BUDGETS:
        return "of kamikazes whose episodes are not kept"
    if name == BEHAVIOUR:
        return "by whom crossings were walked that are not kept, but for the failures"
    return str((name in AT_THE_TOP and AT_THE_TOP[name].told) or Told.ASKED)


def _rows_that_differ(folder: Path) -> list[str]:
    """Return which rows of a campaign say something else than the results of its cells, a line each."""
    path = folder / _CAMPAIGN
    found = []
    try:
        content = read_json(path)
        rows = content["cells"]
        done = [row for row in rows if row["state"] == "done"]
        names = [str(row["name"]) for row in rows]
        if (folder / _CELLS).exists():
            asked = [str(cell["name"]) for cell in read_json(folder / _CELLS)["cells"]]
            found += [f"{path}: has no row of cell {name}, which was asked for" for name in asked if name not in names]
            found += [
                f"{path}: has a row of cell {name}, which nobody asked for" for name in names if name not in asked
            ]
        if content.get("done", len(done)) != len(done):
            found.append(f"{path}: says that {content['done']!r:.20} cells are done, and has {len(done)} rows of such")
        for row in done:
            name = str(row["name"])
            if Path(name).name != name:
                found.append(f"{path}: {name!r} is no name of a cell's folder")
            else:
                found += [f"{path}: cell {name}: {line}" for line in _differences(row, folder / name)]
        if (folder / _TABLE).exists():
            found += _table_that_differs(folder / _TABLE, rows)
    except UsageError as error:
        found.append(str(error))
    except (LookupError, TypeError, AttributeError) as error:
        found.append(f"{path}: is not of a campaign ({type(error).__name__}: {error})")
    return found


def _sweep_that_differs(folder: Path) -> list[str]:
    """Return which rows of a sweep say something else than the results of its cars, a line each."""
    path = folder / _SWEEP
    found = []
    try:
        rows = read_json(path)["rows"]
        for row in rows:
            kind, car = str(row["kind"]), f"C_{float(row['multiplier']):.12g}"
            if Path(kind).name != kind:
                found.append(f"{path}: {kind!r:.60} is no name of a folder")
            else:
                found += [f"{path}: {kind}, {car}: {line}" for line in _differences(row, folder / kind / car)]
        table = path.with_suffix(".csv")
        return [*found, *(_table_that_differs(table, rows) if table.exists() else ())]
    except UsageError as error:
        return [*found, str(error)]
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        return [*found, f"{path}: is not of a sweep ({type(error).__name__}: {error})"]


def _differences(row: Mapping[str, Any], cell: Path) -> list[str]:
    """Return what a row says that its cell's folder does not, and which of its warnings it does not say."""
    figures = read_json(cell / ASSESSMENT)
    same = {key for key in row if key in figures and key not in ("warnings", "scenario")}
    found = [
        f"{key} is {row[key]!r:.60}, in its folder {figures[key]!r:.60}"
        for key in sorted(same)
        if row[key] != figures[key]
    ]
    digests = row.get("sha256") or {}  # rows of older versions have none
    found += [
        f"{name} is not the file that the row is of: its SHA-256 is another"
        for name in (ASSESSMENT, EPISODES)
        if name in digests and digests[name] != sha256_of(cell / name)
    ]
    if "warnings" not in row:  # of a sweep
        return found
    said = {*row["warnings"], *row.get("problems", ())}
    return [*found, *(f"does not say {line!r:.90}" for line in figures.get("warnings", ()) if line not in said)]


def _table_that_differs(path: Path, rows: list[Mapping[str, Any]]) -> list[str]:
    """Return where the CSV of a campaign or a sweep says something else than its rows, in a line; none: nowhere."""
    try:
        table = list(csv.DictReader(io.StringIO(read_text(path))))
    except csv.Error as error:
        return [f"{path}: is no CSV ({error})"]
    if len(table) != len(rows):
        return [f"{path}: has {len(table)} rows, and {len(rows)} are in the JSON beside it"]
    for line, (said, row) in enumerate(zip(table, rows, strict=True), 2):
        for key, cell in said.items():
            value = row.get(key)
            text = " ".join(map(str, value)) if isinstance(value, list) else "" if value is None else str(value)
            if cell != text:
                said_there, here = (f"{one or 'blank'!r:.60}" for one in (text, cell))
                return [f"{path}, line {line}: {key} is {here}, in the JSON beside it {said_there}"]
    return []


def _surrogates_that_differ(path: Path, found: Surrogates) -> list[str]:
    """Return where the file says something else than follows from the episodes, in a line; none: nowhere."""
    try:
        said = list(csv.reader(io.StringIO(read_text(path))))
    except UsageError as error:
        return [str(error)]
    except csv.Error as error:
        return [f"{path}: is no CSV ({error})"]
    written = io.StringIO()
    found.write_csv(written)
    again = list(csv.reader(written.getvalue().splitlines()))
    if said[:1] != again[:1] or len(said) != len(again):
        return [f"{path}: has other columns or rows than its {len(found.logs)} episodes give"]
    for line, (row, expected) in enumerate(zip(said, again, strict=True), 1):
        cells = zip(again[0], row, expected, strict=False)
        wrong = [(name, cell, other) for name, cell, other in cells if not _same_cell(cell, other)]
        if wrong or len(row) != len(expected):
            name, cell, other = wrong[0] if wrong else ("the number of its cells", str(len(row)), str(len(expected)))
            return [f"{path}, line {line}: {name} is {cell[:40] or 'blank'}, its episode gives {other or 'blank'}"]
    return []


def _same_cell(said: str, found: str) -> bool:
    if said == found:
        return True
    try:
        one, other = float(said), float(found)
    except ValueError:
        return False
    return math.isclose(one, other, rel_tol=_AGREE, abs_tol=_AGREE)
