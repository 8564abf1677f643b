"""Running many episodes in process, on several cores."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from types import TracebackType
from typing import TypeVar

from skd_sim.controllers import BUILT_IN, BasicController, make_controller
from skd_sim.episode import Episode, EpisodeLog

from skd_evaluator.errors import AssessmentError
from skd_evaluator.guarded_controller import guard
from skd_evaluator.runner import run_episode

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def available_workers() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _run(episode: Episode) -> EpisodeLog:
    if episode.controller in BUILT_IN:
        return run_episode(episode)
    controller = make_controller(episode.controller, episode.multiplier)
    return run_episode(episode, guard(controller, episode.controller))


def _prepare_worker() -> None:
    # Ctrl-C reaches the whole process group; the parent alone decides how to end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, args=(os.getppid(),), daemon=True).start()


def _end_with_parent(parent: int) -> None:
    """End this worker when its parent has been killed: nobody is left to take its results."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


def _ready() -> None:
    """Do nothing: makes the pool start its workers."""


class InProcessRunner:
    """Runs episodes in this process, or in worker processes forked from it; the results are the same."""

    def __init__(self, workers: int = 1) -> None:
        """Use `workers` processes; with one, episodes run in the caller's own."""
        if workers < 1:
            raise ValueError(f"at least one worker is needed, got {workers}")
        self._workers = workers
        self._pool: ProcessPoolExecutor | None = None
        self._processes: list[multiprocessing.process.BaseProcess] = []

    def __enter__(self) -> InProcessRunner:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close(wait=kind is None)

    def start(self, warm_up: Sequence[Episode] = ()) -> None:
        """Start the workers, after running `warm_up` here: forked workers then inherit the compiled kernels.

        Call it before other threads start: a process with threads is not safe to fork.
        """
        for episode in warm_up:
            run_episode(episode, BasicController())  # compiles all the same, and leaves a user's controller alone
        if self._workers > 1 and self._pool is None:
            context = multiprocessing.get_context("fork")
            others = multiprocessing.active_children()
            self._pool = ProcessPoolExecutor(self._workers, context, initializer=_prepare_worker)
            self._pool.submit(_ready).result()
            self._processes = [child for child in multiprocessing.active_children() if child not in others]

    def run(self, episodes: Sequence[Episode]) -> Iterator[EpisodeLog]:
        """Run all of `episodes` and yield their logs in the same order.

        Raises:
            AssessmentError: the controller under test raised or gave no finite number, or a worker died.
        """
        yield from self.map(_run, episodes)

    def map(self, work: Callable[[_Item], _Result], items: Sequence[_Item]) -> Iterator[_Result]:
        """Do `work`, a function of a module, on every item and yield what it returns in the same order.

        Raises:
            AssessmentError: a worker died.
        """
        if self._workers == 1:
            yield from map(work, items)
            return
        self.start()
        assert self._pool is not None
        chunk = max(1, min(16, len(items) // (4 * self._workers)))
        try:
            yield from self._pool.map(work, items, chunksize=chunk)
        except BrokenProcessPool as error:
            raise AssessmentError(
                "a worker process died: killed, out of memory, or ended by the controller under test; "
                "--workers 1 shows which"
            ) from error

    def close(self, *, wait: bool = True) -> None:
        """End the workers; what has not begun is dropped, and what has begun too unless `wait`."""
        if self._pool is None:
            return
        if not wait:
            for process in self._processes:
                process.terminate()
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._pool = None
