"""How far a campaign is: a bar on a terminal, a line now and then where there is none."""

from __future__ import annotations

import datetime
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from skd_evaluator.assessment.context import Progress as CampaignProgress
from skd_evaluator.verbosity import is_verbose, say

LINE_EVERY = 30.0
"""s between two lines where there is no terminal."""
FIRST_LINE = 5.0
"""s until the first of them."""
PREPARING = "preparing; a first run compiles code for a minute or two, and keeps it"


@contextmanager
def progress_bar(*, quiet: bool = False) -> Iterator[CampaignProgress]:
    """Yield a callback that shows on standard error how far it is, with the rate and the time left, unless `quiet`.

    On a terminal it draws a bar, elsewhere it says a line every 30 s. Several threads may call it at once.
    """
    if quiet:
        yield lambda _label, _done, _total: None
    elif sys.stderr.isatty() and not is_verbose():
        with _bar() as update:
            yield update
    else:
        stages = _say_stages() if is_verbose() else None
        lines = ProgressLines(lambda line: print(f"skd: {line}", file=sys.stderr, flush=True))

        def update(label: str, done: int, total: int) -> None:
            lines.update(label, done, total)
            if stages is not None:
                stages(label, done, total)

        over = threading.Event()

        def speak() -> None:
            wait = min(FIRST_LINE, LINE_EVERY)
            while not over.wait(wait):
                lines.say()
                wait = LINE_EVERY

        threading.Thread(target=speak, name="skd-progress", daemon=True).start()
        try:
            yield update
        finally:
            over.set()


class _Rate(ProgressColumn):
    """How many are done in a second."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text("" if speed is None else f"{_rate(speed)}/s", justify="right")


@contextmanager
def _bar() -> Iterator[CampaignProgress]:
    columns = (
        TextColumn("{task.description:<22}"), BarColumn(bar_width=16), MofNCompleteColumn(), _Rate(),
        TimeElapsedColumn(), TimeRemainingColumn(compact=True), TextColumn("left"),
    )  # fmt: skip
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        tasks: dict[str, Any] = {}
        lock = threading.Lock()
        preparing = progress.add_task("preparing", total=None)

        def update(label: str, done: int, total: int) -> None:
            with lock:
                progress.update(preparing, visible=False)
                if label not in tasks:
                    tasks[label] = progress.add_task(label, total=total)
                progress.update(tasks[label], completed=done, total=total)

        yield update


class _Stage(NamedTuple):
    begin: float
    before: int  # done when it began
    done: int
    total: int


class ProgressLines:
    """Says of each stage that is under way how many are done of how many, how fast, and how long it will still take."""

    def __init__(self, write: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> None:
        """Begin.

        Args:
            write: called with each line.
            clock: returns the time, s.
        """
        self._write, self._clock = write, clock
        self._stages: dict[str, _Stage] = {}
        self._lock = threading.Lock()
        self._begun = False  # whether anything is done, or was said
        self._last = clock()  # when something was done, before which no stage has begun

    def update(self, label: str, done: int, total: int) -> None:
        """Learn how far a stage is."""
        with self._lock:
            now = self._clock()
            self._begun = True
            known = self._stages.get(label) or _Stage(self._last, max(0, done - 1), done, total)
            self._stages[label] = known._replace(done=done, total=total)
            self._last = now

    def say(self) -> None:
        """Write a line for each stage that has not come to its end; before the first, once, that work is prepared."""
        with self._lock:
            now = self._clock()
            going = {label: stage for label, stage in self._stages.items() if stage.done < stage.total}
            begun, self._begun = self._begun, True
        if not begun:
            self._write(PREPARING)
        for label, stage in going.items():
            self._write(progress_line(label, stage.done, stage.total, stage.done - stage.before, now - stage.begin))


def progress_line(label: str, done: int, total: int, recent: int, seconds: float) -> str:
    """Return in one line how far a stage is.

    Args:
        label: name of the stage.
        done: number of parts of the stage that are done.
        total: number of all parts of the stage.
        recent: how many of the parts that are done took the time `seconds`.
        seconds: time that the recent parts took, s.
    """
    line = f"{label}: {done} of {total}"
    if recent <= 0 or seconds <= 0.0:
        return line
    rate = recent / seconds
    left = datetime.timedelta(seconds=round((total - done) / rate))
    return f"{line}, {_rate(rate)}/s, {left} left"


def _rate(value: float) -> str:
    """Return a rate with three digits that count."""
    return f"{value:.0f}" if value >= 99.95 else f"{value:.3g}"


def _say_stages() -> CampaignProgress:
    """Return a callback that says each stage when it is done, and how long it took."""
    begin = time.perf_counter()

    def update(label: str, done: int, total: int) -> None:
        nonlocal begin
        if done == total:
            now = time.perf_counter()
            say(f"{label}: {total} after {now - begin:.1f} s")
            begin = now

    return update
