"""Campaigns: cells run several at a time over one runner, those of the node graph one by one; and their folder.

The folder has an ordinary result folder for each cell, there as soon as it is complete, and a summary. It is safe at
any moment: a file is written under another name, brought to the disk and renamed. `cells.json` says what was requested
and is written first; `campaign.json` names the cells that are done and is written after each. What is not in it is made
again from the stored episodes, which are forgotten only then.
"""

from __future__ import annotations

import concurrent.futures
import fcntl
import json
import os
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from skd_sim.errors import AssessmentError, OutOfReachError, UsageError
from skd_sim.inputs.files import read_json, sha256_of
from skd_sim.inputs.yaml_file import short
from skd_sim.options.options import further_options

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.compare.comparability import unlike_rows
from skd_evaluator.assessment.context import Context, Progress, Runner
from skd_evaluator.assessment.files import episode_store
from skd_evaluator.assessment.files.result_folder import csv_text, write_manifests
from skd_evaluator.assessment.run.workers import Workers
from skd_evaluator.assessment.stages.checks import fresh_process
from skd_evaluator.assessment.stages.pipeline import run_stages
from skd_evaluator.extensions.campaign import cells as of_cells
from skd_evaluator.extensions.campaign.cells import DONE, FAILED, FIRST, Cell, Row
from skd_evaluator.files import MARKERS, PREFIX, make_temporary, replace_file, umask
from skd_evaluator.provenance import date_now, provenance, sums_of
from skd_evaluator.report.presentation import fill
from skd_evaluator.ros.processes import GraphSetting
from skd_evaluator.ros.session import assess_through_graph

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
        paths = {path for cell in cells for path in cell.identity["file"] or ()}
        requested = {"cells": [{"name": cell.name, **cell.identity} for cell in cells], "files": sums_of(sorted(paths))}
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
        advice = "since this campaign began; put it back, or give another --out"
        then, now = ({str(cell["name"]): cell for cell in one["cells"]} for one in (before, requested))
        if other := sorted(then.keys() ^ now.keys()):
            raise UsageError(f"{self._option}: cell {other[0]} has {'come' if other[0] in now else 'gone'} {advice}")
        for file, (first, second) in episode_store.changes(before.get("files", {}), requested["files"]).items():
            how = "come" if first is None else "gone" if second is None else "changed"
            raise UsageError(f"{self._option}: file {file} of a car has {how} {advice}")
        for name, cell in now.items():
            for key, (first, second) in episode_store.changes(then[name], cell).items():
                what = f"has changed from {short(first)} to {short(second)}"
                raise UsageError(f"{self._option}: {key} of cell {name} {what} {advice}")

    def _clear(self, cells: Sequence[str]) -> None:
        """Remove the campaign that is there, by its cells; the file that says that there is one goes last."""
        for cell in cells:
            self._remove_cell(self.path / cell)
            shutil.rmtree(self.path / f"{cell}.logs", ignore_errors=True)
        episode_store.remove_files(self.path / episode_store.FILE_NAME)
        for name in (CAMPAIGN, TABLE, CELLS):
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
            digests = {one: sha256_of(temporary / one) for one in of_cells.CHECKED}
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


_SELDOM = 20.0  # times as long as it takes to write the rows they are not written again
_COUNTED = ("safe trajectories", "kamikazes", "nominal runs")  # stages whose episodes were foreseen
_FAREWELL = 10.0  # s for cells to notice that they are to stop


def _command_of(cell: Cell) -> str:
    """Return the command that starts the car's own node; empty if it has none."""
    return (cell.graph.controller_command if cell.graph else None) or ""


def _say(cell: Cell, line: str) -> None:
    print(f"skd campaign: {cell.name}: {line}", file=sys.stderr, flush=True)


class Campaign:
    """Cells, of which some may be done, and the store of the others' episodes.

    Attributes:
        rows: what is known of each cell, in the order of the file.
    """

    def __init__(
        self, cells: Sequence[Cell], folder: CampaignFolder, command: Sequence[str], *, maximum_aborted: float
    ) -> None:
        """Look at what there is, and open the store.

        Args:
            cells: all of them.
            folder: theirs, which this object does not close.
            command: words of the command line, for results.
            maximum_aborted: share of a cell's episodes that may be aborted.

        Raises:
            UsageError: the store or a result is damaged.
            StoreError: likewise.
        """
        self._folder, self._command, self._maximum_aborted = folder, command, maximum_aborted
        self._begin = time.perf_counter()
        # Found here, once: who starts a program while another thread forks a worker waits for that worker's end, too,
        # which has the pipe by which the program says that it has begun.
        self._origins: dict[tuple[str, str], dict[str, Any]] = {}
        for cell in cells:
            car, words = cell.plan.car, _command_of(cell)
            if (car.controller, words) not in self._origins:
                self._origins[car.controller, words] = provenance(command, car, controller_command=words)
        self._lock = threading.Lock()  # of rows and of pictures
        self._stop = threading.Event()
        done = folder.done_rows()
        self._cells = cells
        self.rows: list[Row] = [done.get(cell.name) or of_cells.open_row(cell) for cell in cells]
        todo = [cell for cell in cells if cell.name not in done]
        self.in_process = [cell for cell in todo if cell.graph is None]
        self.through_graph = [cell for cell in todo if cell.graph is not None]
        self._runs: dict[str, episode_store.StoringRunner] = {}
        self._unsaved: list[Cell] = []  # cells that are done, of which campaign.json does not know yet
        self._saved = self._cost = 0.0
        self._store = episode_store.EpisodeStore(folder.path / episode_store.FILE_NAME) if todo else None
        if self._store is not None:
            self._store.keep_only([cell.key for cell in todo])
        else:  # a campaign that was killed after its last cell has left it
            episode_store.remove_files(folder.path / episode_store.FILE_NAME)
        self._save()

    @property
    def kept_episodes(self) -> int:
        """How many episodes of cells that are not done are stored."""
        return 0 if self._store is None else self._store.count()

    @property
    def content(self) -> dict[str, Any]:
        """Content of campaign.json."""
        return {
            "cells": self.rows,
            "done": sum(row["state"] == DONE for row in self.rows),
            "failed": sum(row["state"] == FAILED for row in self.rows),
            "planned_refusal": self._planned_refusal(),
            "episodes_run": sum(one.given - one.read for one in self._runs.values()),
            "episodes_read": sum(one.read for one in self._runs.values()),
            "seconds": round(time.perf_counter() - self._begin, 3),
        }

    def _planned_refusal(self) -> str:
        """Return why planned figures of the cells cannot be compared, in one line; empty if they can."""
        rows = zip(self.rows, self._cells, strict=True)
        unlike = unlike_rows({**row, "options": further_options(cell.plan)} for row, cell in rows)
        return f"planned figures are not compared: the cells have {unlike}; go by the margin" if unlike else ""

    def close(self) -> None:
        """Close the store; delete it where all cells are done."""
        if self._store is None:
            return
        # After an error, which then is what is to be said.
        with self._lock, suppress(OSError, episode_store.StoreError):
            self._save()
        if all(row["state"] == DONE for row in self.rows) and not self._unsaved:
            self._store.remove()
        else:
            self._store.close()

    def run(self, runner: Workers, progress: Progress, threads: int) -> None:
        """Run the cells that run in process; one that fails is a row that says why, and the others go on.

        Args:
            runner: started; it serves several threads.
            progress: called with how far all of it is.
            threads: how many cells run at a time.

        Raises:
            StoreError: no episode can be stored any more.
            OutOfReachError: none can be run any more.
        """
        tell = _overall(self.in_process, progress)
        pool = concurrent.futures.ThreadPoolExecutor(threads)
        running = [pool.submit(self._try, cell, tell(cell), runner) for cell in self.in_process]
        try:
            for future in concurrent.futures.as_completed(running):
                with suppress(episode_store.StoppedError):  # of a cell beside the one that has failed
                    future.result()
        except BaseException:  # no thread may use the store or the runner after an error or an interrupt
            self._stop.set()
            runner.close(wait=False)
            pool.shutdown(wait=False, cancel_futures=True)
            concurrent.futures.wait([one for one in running if not one.cancelled()], _FAREWELL)
            raise
        pool.shutdown()
        with self._lock:
            self._save()

    def run_graphs(self, progress: Progress) -> None:
        """Run the cells of the node graph, one after the other."""
        tell = _overall(self.through_graph, progress)
        for cell in self.through_graph:
            self._try(cell, tell(cell))
        with self._lock:
            self._save()

    def _try(self, cell: Cell, progress: Progress, runner: Workers | None = None) -> None:
        """Run a cell, by a runner or through its graph; take note of a failure that is the cell's own."""
        if self._stop.is_set():
            raise episode_store.StoppedError
        try:
            self._assess(cell, progress, runner)
        except (episode_store.StoreError, OutOfReachError):
            self._stop.set()  # before this thread takes another cell
            raise
        except (AssessmentError, UsageError) as error:
            if self._stop.is_set():
                raise episode_store.StoppedError from error
            with self._lock:
                self._row_of(cell).update(state=FAILED, problems=[str(error)])
                self._save(at_once=False)

    def _assess(self, cell: Cell, progress: Progress, runner: Workers | None) -> None:
        begin, how = time.perf_counter(), {"progress": progress, "say": partial(_say, cell), **cell.requested}
        origin = {**self._origins[cell.plan.controller, _command_of(cell)], "date": date_now()}
        assessment = Assessment(cell.plan, provenance=origin)
        with nullcontext() if cell.graph is None else self._folder.logs(cell.name) as logs:
            if runner is not None:
                fresh = partial(fresh_process, cell.answer_limit)
                assessment = run_stages(Context(self._storing(cell, runner), runner, fresh=fresh, **how), assessment)
            elif cell.graph is not None and logs is not None:
                car, simulator = cell.plan.car, cell.plan.simulator
                setting = GraphSetting(options=cell.graph, car=car, log_folder=logs, simulator=simulator)
                try:
                    assessment = assess_through_graph(assessment, setting, how, partial(self._storing, cell))
                except OSError as error:  # as where its car has removed the logs: it is no matter of the other cells
                    raise AssessmentError(f"its graph cannot run: {error}") from error
            self._finish(cell, replace(assessment, seconds=time.perf_counter() - begin), logs)

    def _storing(self, cell: Cell, runner: Runner) -> episode_store.StoringRunner:
        assert self._store is not None
        self._runs[cell.name] = episode_store.StoringRunner(runner, self._store, cell.key, self._stop)
        return self._runs[cell.name]

    def _finish(self, cell: Cell, assessment: Assessment, logs: Path | None) -> None:
        """Write the folder of a cell, take note of it, and forget its stored episodes: in this order."""

        def write(folder: Path) -> None:
            fill(folder, assessment)
            if logs is not None and logs.is_dir() and any(logs.iterdir()):
                logs.rename(folder / "logs")

        with self._lock:
            if self._stop.is_set():
                raise episode_store.StoppedError
            digests = self._folder.write_cell(cell.name, write)
            row = of_cells.done_row(cell, assessment, maximum_aborted=self._maximum_aborted, digests=digests)
            self._row_of(cell).update(row)
            self._unsaved.append(cell)
            self._save(at_once=False)

    def _row_of(self, cell: Cell) -> Row:
        return next(row for row in self.rows if row["name"] == cell.name)

    def _save(self, *, at_once: bool = True) -> None:
        """Write what is known of the cells, then forget the episodes of those that are done.

        Unless it is to be at once, only a small share of the time is spent on it, for there may be thousands of rows.
        After a kill in between, the latest cells are made again, from the store.
        """
        now = time.monotonic()
        if not at_once and now - self._saved < _SELDOM * self._cost:
            return
        swept = dict.fromkeys(f"sweep.{key}" for cell in self._cells for key in cell.swept if key not in FIRST)
        self._folder.write_rows(self.content, (*FIRST, *swept, "episodes", *of_cells.OF_PLANS, *of_cells.FIGURES))
        self._saved = time.monotonic()
        self._cost = self._saved - now
        while self._unsaved and self._store is not None:
            self._store.drop(self._unsaved[-1].key)
            self._unsaved.pop()


def _overall(cells: Sequence[Cell], progress: Progress) -> Callable[[Cell], Progress]:
    """Return what gives each cell a function to report by: episodes that count, of as many as all cells have."""
    total = sum(cell.episodes() for cell in cells)
    done: dict[tuple[str, str], int] = {}
    lock = threading.Lock()

    def of(cell: Cell) -> Progress:
        def tell(stage: str, count: int, _total: int) -> None:
            if stage.startswith(_COUNTED):
                with lock:
                    done[cell.name, stage] = count
                    progress("episodes", min(total, sum(done.values())), total)

        return tell

    return of
