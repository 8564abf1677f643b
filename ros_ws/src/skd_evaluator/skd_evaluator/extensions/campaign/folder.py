"""The folder of a campaign: an ordinary result folder for each cell, there as soon as it is complete, and a summary.

It is safe at any moment: a file is written under another name, brought to the disk and renamed. `cells.json` says what
was requested and is written first; `campaign.json` names the cells that are done and is written after each. What is not
in it is made again from the stored episodes, which are forgotten only then.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from skd_sim.errors import UsageError
from skd_sim.inputs.files import read_json, sha256_of
from skd_sim.inputs.yaml_file import short

from skd_evaluator.assessment.files.episode_store import FILE_NAME as STORE
from skd_evaluator.assessment.files.result_folder import csv_text, write_manifests
from skd_evaluator.extensions.campaign.cells import CHECKED, Cell
from skd_evaluator.files import MARKERS, PREFIX, make_temporary, replace_file, umask

CELLS, CAMPAIGN, TABLE, _LOCK = "cells.json", "campaign.json", "campaign.csv", ".lock"


class CampaignFolder:
    """A campaign's output, locked as long as this object is not closed, at the latest until its process ends.

    Attributes:
        path: path of the folder.
        resumed: whether there was something to go on with.
    """

    def __init__(self, path: Path, cells: Sequence[Cell], *, resume: bool = False, overwrite: bool = False) -> None:
        """Take the folder, and begin a campaign in it or go on with the one that is there.

        Args:
            path: path of the folder.
            cells: what is requested.
            resume: whether to go on with what is there.
            overwrite: whether to replace what is there.

        Raises:
            UsageError: it holds something else, another process works in it, or what was requested
                then is not what is requested now.
            OSError: it cannot be written.
        """
        self.path, self._option = path, f"--out {path}"
        self._descriptor: int | None = None
        if path.exists() and not path.is_dir():
            raise UsageError(f"{self._option}: is a file; give a folder")
        self._refuse_foreign()
        path.mkdir(parents=True, exist_ok=True)
        self._lock()
        try:
            self.resumed = self._begin(cells, resume=resume, overwrite=overwrite)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Let others have the folder."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def _begin(self, cells: Sequence[Cell], *, resume: bool, overwrite: bool) -> bool:
        for left in self.path.glob(f"{PREFIX}*"):  # by one that was killed: the lock is ours
            if left.is_dir() and not left.is_symlink():
                shutil.rmtree(left, ignore_errors=True)
            else:
                left.unlink(missing_ok=True)
        known = self.path / CELLS
        requested = {"cells": [{"name": cell.name, **cell.identity} for cell in cells]}
        if known.exists():
            before = _read_json(known)
            if resume:
                self._refuse_changed(requested, before)
                return True
            if not overwrite:
                raise UsageError(f"{self._option}: holds a campaign; --resume goes on with it, --overwrite replaces it")
            self._clear([str(cell["name"]) for cell in before["cells"]])
        replace_file(known, _json(requested))
        return False

    def _refuse_foreign(self) -> None:
        """Refuse a folder that holds something and is no campaign's."""
        if not self.path.is_dir() or (self.path / CELLS).exists():
            return
        others = [one.name for one in self.path.iterdir() if one.name != _LOCK and not one.name.startswith(PREFIX)]
        if others:
            raise UsageError(f"{self._option}: is not empty and holds no campaign ({others[0]:.60}); give a new folder")

    def _lock(self) -> None:
        # Of POSIX: a worker that has been forked does not share it, so it ends with this process however that ends.
        self._descriptor = os.open(self.path / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            fcntl.lockf(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self.close()
            if isinstance(error, (BlockingIOError, PermissionError)):
                raise UsageError(f"{self._option}: another campaign is running there; give another folder") from error
            raise

    def _refuse_changed(self, requested: Mapping[str, Any], before: Mapping[str, Any]) -> None:
        """Refuse to go on with a campaign of which something has changed, and say what."""
        then = {str(cell["name"]): _flat(cell) for cell in before["cells"]}
        now = {str(cell["name"]): _flat(cell) for cell in json.loads(json.dumps(requested))["cells"]}
        advice = "since this campaign began; put it back, or give another --out"
        if other := sorted(then.keys() ^ now.keys()):
            raise UsageError(f"{self._option}: cell {other[0]} has {'come' if other[0] in now else 'gone'} {advice}")
        for name, cell in now.items():
            for key in {**cell, **then[name]}:
                first, second = then[name].get(key), cell.get(key)
                if first != second:
                    what = f"has changed from {short(first)} to {short(second)}"
                    raise UsageError(f"{self._option}: {key} of cell {name} {what} {advice}")

    def _clear(self, cells: Sequence[str]) -> None:
        """Remove the campaign that is there, by its cells; the file that says that there is one goes last."""
        for cell in cells:
            self._remove_cell(self.path / cell)
            shutil.rmtree(self.path / f"{cell}.logs", ignore_errors=True)
        for name in (CAMPAIGN, TABLE, *(f"{STORE}{suffix}" for suffix in ("", "-wal", "-shm")), CELLS):
            (self.path / name).unlink(missing_ok=True)

    def _remove_cell(self, folder: Path) -> None:
        """Remove a result of ours."""
        if not folder.exists():
            return
        if not any((folder / marker).exists() for marker in MARKERS):
            raise UsageError(f"{folder}: is in the place of a cell and holds no results of SKD; move it away")
        shutil.rmtree(folder)

    # --- what is done

    def done_rows(self) -> dict[str, dict[str, Any]]:
        """Return the rows of cells that are done and whose folders are there, by their names.

        Raises:
            UsageError: a result is not what was written.
        """
        if not self.resumed or not (self.path / CAMPAIGN).exists():
            return {}
        rows = {str(row["name"]): row for row in _read_json(self.path / CAMPAIGN)["cells"] if row.get("sha256")}
        found = {name: row for name, row in rows.items() if (self.path / name).is_dir()}
        for name, row in found.items():
            for file, digest in row["sha256"].items():
                path = self.path / name / file
                if not path.is_file() or sha256_of(path) != digest:
                    raise UsageError(f"{path}: is not what was written; remove the cell, and --resume makes it again")
        return found

    @contextmanager
    def logs(self, cell: str) -> Iterator[Path]:
        """Yield a folder for what the processes of a cell print: beside the cell's, and it stays if the work fails."""
        folder = self.path / f"{cell}.logs"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        try:
            yield folder
        except Exception:
            with suppress(OSError):  # something is in it, or a car has removed it
                folder.rmdir()
            raise
        shutil.rmtree(folder, ignore_errors=True)

    def write_cell(self, name: str, fill: Callable[[Path], None]) -> dict[str, str]:
        """Let `fill` write into a temporary folder, and put it in its place when it is whole and on the disk.

        Returns:
            The SHA-256 of the files that say what the cell came to.

        Raises:
            OSError: it cannot be written; nothing has changed.
        """
        target = self.path / name
        temporary = make_temporary(self.path)
        try:
            temporary.chmod(0o777 & ~umask())
            fill(temporary)
            write_manifests(temporary)
            digests = {one: sha256_of(temporary / one) for one in CHECKED}
            _to_disk(temporary)
            self._remove_cell(target)
            temporary.rename(target)
        except BaseException:
            shutil.rmtree(temporary, ignore_errors=True)
            raise
        _to_disk(self.path, only=True)
        return digests

    def write_rows(self, content: Mapping[str, Any], columns: Sequence[str]) -> None:
        """Write campaign.json and, of its rows, campaign.csv."""
        replace_file(self.path / CAMPAIGN, _json(content))
        replace_file(self.path / TABLE, csv_text(content["cells"], columns))


def _to_disk(folder: Path, *, only: bool = False) -> None:
    """Make sure that a folder is on the disk, with all that is in it unless `only`."""
    for path in [folder] if only else [*folder.rglob("*"), folder]:
        descriptor = os.open(path, os.O_RDONLY)
        try:
            with suppress(OSError):  # of a folder, some file systems cannot
                os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _json(content: Mapping[str, Any]) -> str:
    return json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _read_json(path: Path) -> dict[str, Any]:
    data = read_json(path)
    cells = data.get("cells") if isinstance(data, dict) else None
    if not isinstance(cells, list) or not all(isinstance(one, dict) and "name" in one for one in cells):
        raise UsageError(f"{path}: is not of a campaign; give another --out")
    return dict(data)


def _flat(content: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested mappings as one, with the keys in between joined by dots."""
    found: dict[str, Any] = {}
    for key, value in content.items():
        if isinstance(value, Mapping):
            found |= _flat(value, f"{prefix}{key}.")
        else:
            found[f"{prefix}{key}"] = value
    return found
