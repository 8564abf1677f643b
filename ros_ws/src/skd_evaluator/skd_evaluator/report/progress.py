"""How far a command is, on standard error: one line that changes on a terminal, elsewhere a line for each step."""

from __future__ import annotations

import multiprocessing
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich import progress as bars
from rich.console import Console
from rich.text import Text
from skd_sim.kernels.compilation import on_compiling

from skd_evaluator.assessment.context import Progress as CampaignProgress

LINE_EVERY = 60.0
"""s between two lines of a step where there is no terminal."""
SILENT = 5.0
"""s before the first line: what is done by then needs none."""
CREDIBLE = 10.0
"""% of a step that are done before it is said how long the rest takes."""
COMPILING = "compiling for this kind of car: up to two minutes, kept for later runs"


@contextmanager
def progress_bar(*, quiet: bool = False, steps: Sequence[str] = ()) -> Iterator[CampaignProgress]:
    """Yield a callback that shows how far the work is, unless `quiet`. Several threads may call it at once.

    Args:
        quiet: show nothing.
        steps: how the labels of each step of the work begin, in order.
    """
    if quiet:
        yield lambda _label, _done, _total: None
        return

    def numbered(label: str) -> str:
        """Return a label with the number of its step before it."""
        found = [number for number, step in enumerate(steps, start=1) if label.startswith(step)]
        return f"step {found[0]} of {len(steps)}: {label}" if found else label

    with _on_terminal(numbered) if sys.stderr.isatty() else _in_lines(numbered) as (update, say):
        unsaid = multiprocessing.Lock()  # shared with workers, which are forked from here: one of all says it
        on_compiling.append(lambda: say(COMPILING) if unsaid.acquire(block=False) else None)
        try:
            yield update
        finally:
            on_compiling.clear()


class _Done(bars.MofNCompleteColumn):
    """How many of how many parts are done; nothing where that is not known."""

    def render(self, task: bars.Task) -> Text:
        return super().render(task) if task.total is not None else Text("")


class _Left(bars.TimeRemainingColumn):
    """The time that is left; nothing where that is not known, or not credible yet."""

    def render(self, task: bars.Task) -> Text:
        known = task.time_remaining and task.percentage >= CREDIBLE
        return super().render(task).append(" left") if known else Text("")


_Shown = tuple[CampaignProgress, Callable[[str], None]]


@contextmanager
def _on_terminal(numbered: Callable[[str], str]) -> Iterator[_Shown]:
    said, bar = bars.TextColumn("{task.description}"), bars.BarColumn(bar_width=16)
    columns = said, bar, _Done(), bars.TimeElapsedColumn(), _Left(compact=True)
    with bars.Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("starting", total=None)
        lock, shown = threading.Lock(), ""

        def update(label: str, done: int, total: int) -> None:
            nonlocal shown
            with lock:
                if label != shown:
                    shown = label
                    progress.reset(task, description=numbered(label), total=total)
                progress.update(task, completed=done, total=total)

        yield update, lambda line: progress.update(task, description=line, total=None)


@contextmanager
def _in_lines(numbered: Callable[[str], str]) -> Iterator[_Shown]:
    def write(line: str) -> None:
        print(f"skd: {line}", file=sys.stderr, flush=True)

    lines = ProgressLines(lambda label, rest: write(f"{numbered(label)}{rest}"))
    yield lines.update, write


class ProgressLines:
    """Writes a line when a step begins, and after each minute that it takes."""

    def __init__(self, write: Callable[[str, str], None]) -> None:
        """Begin.

        Args:
            write: called with the label of a step, and what is said of it.
        """
        self._write, self._lock = write, threading.Lock()
        self._silent_until = time.monotonic() + SILENT
        self._written: dict[str, float] = {}  # when something was written of it

    def update(self, label: str, done: int, total: int) -> None:
        """Learn how far a step is, of which `done` of `total` parts are done."""
        with self._lock:
            now = time.monotonic()
            step, _, budget = label.partition(",")  # a search says its budget behind the comma
            if now < self._silent_until:
                return
            if step not in self._written:
                self._write(step, f" ({total})" if not budget and total > 1 else "")
            elif now - self._written[step] >= LINE_EVERY and done < total:
                self._write(label, f", {done} of {total}")
            else:
                return
            self._written[step] = now
