"""Running the cells of a campaign: several at a time over one runner, those of the node graph one by one."""

from __future__ import annotations

import concurrent.futures
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from skd_sim.errors import UsageError
from skd_sim.options.options import further_options

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.compare.comparability import unlike_rows
from skd_evaluator.assessment.context import Context, Progress, Runner
from skd_evaluator.assessment.files.episode_store import (
    FILE_NAME,
    EpisodeStore,
    StoppedError,
    StoreError,
    StoringRunner,
    remove_files,
)
from skd_evaluator.assessment.run.workers import Workers
from skd_evaluator.assessment.stages.checks import fresh_process
from skd_evaluator.assessment.stages.pipeline import run_stages
from skd_evaluator.errors import AssessmentError, OutOfReachError
from skd_evaluator.extensions.campaign.cells import (
    DONE,
    FAILED,
    FIGURES,
    FIRST,
    OF_PLANS,
    Cell,
    Row,
    done_row,
    open_row,
)
from skd_evaluator.extensions.campaign.folder import CampaignFolder
from skd_evaluator.provenance import date_now, provenance
from skd_evaluator.report.presentation import fill
from skd_evaluator.ros.processes import GraphSetting
from skd_evaluator.ros.session import assess_through_graph

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
        self.rows: list[Row] = [done.get(cell.name) or open_row(cell) for cell in cells]
        todo = [cell for cell in cells if cell.name not in done]
        self.in_process = [cell for cell in todo if cell.graph is None]
        self.through_graph = [cell for cell in todo if cell.graph is not None]
        self._runs: dict[str, StoringRunner] = {}
        self._unsaved: list[Cell] = []  # cells that are done, of which campaign.json does not know yet
        self._saved = self._cost = 0.0
        self._store = EpisodeStore(folder.path / FILE_NAME) if todo else None
        if self._store is not None:
            self._store.keep_only([cell.key for cell in todo])
        else:  # a campaign that was killed after its last cell has left it
            remove_files(folder.path / FILE_NAME)
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
            "planned_refusal": _planned_refusal(self.rows, self._cells),
            "episodes_run": sum(one.given - one.read for one in self._runs.values()),
            "episodes_read": sum(one.read for one in self._runs.values()),
            "seconds": round(time.perf_counter() - self._begin, 3),
        }

    def close(self) -> None:
        """Close the store; delete it where all cells are done."""
        if self._store is None:
            return
        with self._lock, suppress(OSError, StoreError):  # after an error, which then is what is to be said
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
        running = [pool.submit(self._try, cell, partial(self._assess, cell, runner, tell)) for cell in self.in_process]
        try:
            for future in concurrent.futures.as_completed(running):
                with suppress(StoppedError):  # of a cell beside the one that has failed
                    future.result()
        except BaseException:  # no thread may use the store or the runner after an error or an interrupt
            self._stop.set()
            runner.close(wait=False)
            pool.shutdown(wait=False, cancel_futures=True)
            concurrent.futures.wait(running, _FAREWELL)
            raise
        pool.shutdown()
        with self._lock:
            self._save()

    def run_graphs(self, progress: Progress) -> None:
        """Run the cells of the node graph, one after the other."""
        tell = _overall(self.through_graph, progress)
        for cell in self.through_graph:
            self._try(cell, partial(self._assess_graph, cell, tell))
        with self._lock:
            self._save()

    def _try(self, cell: Cell, work: Callable[[], None]) -> None:
        """Do the work of a cell; take note of a failure that is the cell's own."""
        if self._stop.is_set():
            raise StoppedError
        try:
            work()
        except (StoreError, OutOfReachError):
            self._stop.set()  # before this thread takes another cell
            raise
        except (AssessmentError, UsageError) as error:
            if self._stop.is_set():
                raise StoppedError from error
            with self._lock:
                self._row_of(cell).update(state=FAILED, problems=[str(error)])
                self._save(at_once=False)

    def _assess(self, cell: Cell, runner: Workers, tell: Callable[[Cell], Progress]) -> None:
        begin, how = time.perf_counter(), {"progress": tell(cell), "say": partial(_say, cell), **cell.requested}
        fresh = partial(fresh_process, cell.answer_limit)
        context = Context(self._storing(cell, runner), runner, fresh=fresh, **how)
        assessment = run_stages(context, Assessment(cell.plan, provenance=self._provenance(cell)))
        self._finish(cell, replace(assessment, seconds=time.perf_counter() - begin), None)

    def _assess_graph(self, cell: Cell, tell: Callable[[Cell], Progress]) -> None:
        assert cell.graph is not None
        begin = time.perf_counter()
        with self._folder.logs(cell.name) as logs:
            plan, how = cell.plan, {"progress": tell(cell), "say": partial(_say, cell), **cell.requested}
            setting = GraphSetting(options=cell.graph, car=plan.car, log_folder=logs, simulator=plan.simulator)
            begun = Assessment(plan, provenance=self._provenance(cell))
            try:
                assessment = assess_through_graph(begun, setting, how, partial(self._storing, cell))
            except OSError as error:  # as where its car has removed the logs: it is no matter of the other cells
                raise AssessmentError(f"its graph cannot run: {error}") from error
            self._finish(cell, replace(assessment, seconds=time.perf_counter() - begin), logs)

    def _storing(self, cell: Cell, runner: Runner) -> StoringRunner:
        assert self._store is not None
        self._runs[cell.name] = StoringRunner(runner, self._store, cell.key, self._stop)
        return self._runs[cell.name]

    def _provenance(self, cell: Cell) -> dict[str, Any]:
        return {**self._origins[cell.plan.controller, _command_of(cell)], "date": date_now()}

    def _finish(self, cell: Cell, assessment: Assessment, logs: Path | None) -> None:
        """Write the folder of a cell, take note of it, and forget its stored episodes: in this order."""

        def write(folder: Path) -> None:
            fill(folder, assessment)
            if logs is not None and logs.is_dir() and any(logs.iterdir()):
                logs.rename(folder / "logs")

        with self._lock:
            if self._stop.is_set():
                raise StoppedError
            digests = self._folder.write_cell(cell.name, write)
            row = done_row(cell, assessment, maximum_aborted=self._maximum_aborted, digests=digests)
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
        self._folder.write_rows(self.content, (*FIRST, *swept, "episodes", *OF_PLANS, *FIGURES))
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


def _planned_refusal(rows: Sequence[Row], cells: Sequence[Cell]) -> str:
    """Return why planned figures of the cells cannot be compared, in one line; empty if they can."""
    unlike = unlike_rows({**row, "options": further_options(cell.plan)} for row, cell in zip(rows, cells, strict=True))
    return f"planned figures are not compared: the cells have {unlike}; go by the margin" if unlike else ""
