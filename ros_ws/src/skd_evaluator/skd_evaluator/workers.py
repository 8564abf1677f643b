"""Running many episodes in process, on several cores."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from types import TracebackType

from skd_sim.episode import Episode, EpisodeLog

from skd_evaluator.runner import run_episode


def available_workers() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _ignore_interrupt() -> None:
    # Ctrl-C reaches the whole process group; the parent alone decides how to end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


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
            run_episode(episode)
        if self._workers > 1 and self._pool is None:
            context = multiprocessing.get_context("fork")
            self._pool = ProcessPoolExecutor(self._workers, context, initializer=_ignore_interrupt)
            self._pool.submit(_ready).result()

    def run(self, episodes: Sequence[Episode]) -> Iterator[EpisodeLog]:
        """Run all of `episodes` and yield their logs in the same order."""
        if self._workers == 1:
            yield from map(run_episode, episodes)
            return
        self.start()
        assert self._pool is not None
        chunk = max(1, min(16, len(episodes) // (4 * self._workers)))
        yield from self._pool.map(run_episode, episodes, chunksize=chunk)

    def close(self, *, wait: bool = True) -> None:
        """End the workers; what has not begun is dropped."""
        if self._pool is not None:
            self._pool.shutdown(wait=wait, cancel_futures=True)
            self._pool = None
