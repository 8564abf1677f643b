"""Several whole graphs side by side, each in a thread, that run the episodes of one campaign.

A graph takes the next episode when its stack is ready for it: while one starts its controller anew, another drives.
Which graph runs an episode does not matter to what becomes of it. A thread starts all processes of its graph, and lives
longer than they, for the kernel ends them with the thread that started them (`prctl`, PR_SET_PDEATHSIG).
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from types import TracebackType

from skd_sim.world.episode import Episode, EpisodeLog

from skd_evaluator.assessment.judge.rating import Rating
from skd_evaluator.ros.evaluator import Evaluator
from skd_evaluator.ros.readiness.failures import Failures

_POLL = 0.25  # s
_FAREWELL = 30.0  # s that a graph's thread has to end its processes, which have three times three
_ECHO = 8.0  # s: graphs that wait for the same began within a few, and repeat themselves after ten


class _Stopped(BaseException):
    """The pool is to end; no episode is worth waiting for any more."""


MakeGraph = Callable[[int, Callable[[], None]], AbstractContextManager[Evaluator]]
"""Runs the graph of a number, counted from 0, which calls the function while it waits, to be stopped by it."""


def without_echo(say: Callable[[str], None]) -> Callable[[str], None]:
    """Return what says a line once where several graphs say the same at the same time."""
    lock = threading.Lock()
    said: dict[str, float] = {}

    def say_once(line: str) -> None:
        with lock:
            now = time.monotonic()
            if now - said.get(line, -_ECHO) >= _ECHO:
                said[line] = now
                say(line)

    return say_once


class GraphPool:
    """Runs episodes in as many graphs as it has; an `EpisodeRunner`."""

    def __init__(self, count: int, make: MakeGraph, failures: Failures, patience: float) -> None:
        """Start nothing yet.

        Args:
            count: how many graphs there are.
            make: makes each, in its own thread.
            failures: takes note of every episode.
            patience: how long a stack that was started anew may take to be there, wall seconds.
        """
        self._make = make
        self._failures = failures
        self._patience = patience
        self._changed = threading.Condition()
        self._stopping = False
        self._waiting: deque[tuple[int, Episode]] = deque()
        self._logs: dict[int, EpisodeLog] = {}
        self._asked = 0  # episodes, in all batches; one that nobody waits for any more takes no other's place
        self._error: BaseException | None = None
        self._evaluators: dict[int, Evaluator] = {}
        self._threads = [threading.Thread(target=self._serve, args=(number,), daemon=True) for number in range(count)]

    def __enter__(self) -> GraphPool:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._changed:
            self._stopping = True
            self._waiting.clear()
            self._changed.notify_all()
        interrupted: KeyboardInterrupt | None = None
        # A signal in the middle of an import may leave Python's import lock taken for good, and with it a thread that
        # has something to import. Whatever such a thread has started is ended with this process.
        latest = time.monotonic() + _FAREWELL
        for thread in self._threads:
            while thread.is_alive() and time.monotonic() < latest:
                try:
                    thread.join(_POLL)
                except KeyboardInterrupt as again:  # the processes are being ended already, each with its deadline
                    interrupted = again
        if interrupted is not None and kind is None:
            raise interrupted

    def run(self, episodes: Sequence[Episode]) -> Iterator[EpisodeLog]:
        """Run episodes and yield their logs in the order of the episodes.

        Raises:
            AssessmentError: a graph cannot go on, or one episode after the other fails at its start.
        """
        with self._changed:
            first, self._asked = self._asked, self._asked + len(episodes)
            self._waiting.extend(enumerate(episodes, first))
            self._changed.notify_all()
        try:
            for number in range(first, first + len(episodes)):
                log = self._log_of(number)
                self._failures.note(log)
                yield log
        finally:
            with self._changed:
                self._waiting.clear()

    def publish_assessment(self, rating: Rating) -> None:
        """Publish an assessment in the first graph's domain, as soon as it is there: others may have done all the work.

        Raises:
            AssessmentError: that graph cannot start.
        """
        with self._changed:
            while 0 not in self._evaluators:
                if self._error is not None:
                    raise self._error
                self._changed.wait(_POLL)
        self._evaluators[0].publish_assessment(rating)

    def _log_of(self, number: int) -> EpisodeLog:
        with self._changed:
            while number not in self._logs:
                if self._error is not None:
                    raise self._error
                self._changed.wait(_POLL)
            return self._logs.pop(number)

    # --- in a graph's thread

    def _serve(self, number: int) -> None:
        try:
            with self._make(number, self._refuse_to_go_on) as evaluator:
                with self._changed:
                    self._evaluators[number] = evaluator
                    self._changed.notify_all()
                while True:
                    evaluator.prepare(self._patience)
                    place, episode = self._next()
                    log = evaluator.run_episode(episode)
                    with self._changed:
                        self._logs[place] = log
                        self._changed.notify_all()
        except _Stopped:
            pass
        except BaseException as error:
            with self._changed:
                self._error = self._error or error
                self._changed.notify_all()

    def _next(self) -> tuple[int, Episode]:
        with self._changed:
            while not self._waiting:
                self._refuse_to_go_on()
                self._changed.wait(_POLL)
            return self._waiting.popleft()

    def _refuse_to_go_on(self) -> None:
        if self._stopping:
            raise _Stopped
