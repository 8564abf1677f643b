"""Worker processes that may die, stop or fall silent: each is replaced, and what it was at is reported as lost."""

from __future__ import annotations

import atexit
import contextlib
import multiprocessing
import os
import signal
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.sharedctypes import RawArray
from typing import Any, TypeVar

from skd_sim.aborts import AbortKind, abort_reason
from skd_sim.errors import UsageError
from skd_sim.interruption import SIGNALS

from skd_evaluator.campaign import guarded_controller
from skd_evaluator.errors import AssessmentError

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

FAILED_STARTS = 3
"""So many workers in a row that end before they have finished anything end the work."""
ANSWER_LIMIT = 60.0
"""s that a call of a controller may take."""
HEARTBEAT_LIMIT = 20.0
"""s without a heartbeat, which beats twice a second, after which a worker is stopped or stuck."""
_BEAT = 0.5  # s
_POLL = 0.25  # s
_PATIENCE = 1.0  # s for a worker to end after SIGTERM
_LARGEST_CHUNK = 16

_BEATS, _CALLED = 0, 1  # what a worker writes: heartbeats, and whether it is in a call of the controller


def _serve(connection: Connection, signs: Any, answer_limit: float) -> None:
    """Work until there is no more: in the worker."""
    # Ctrl-C reaches the whole process group; the parent alone decides how to end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    threading.Thread(target=_beat, args=(os.getppid(), signs, answer_limit), daemon=True).start()
    while (task := connection.recv()) is not None:
        work, items = task
        for item in items:
            try:
                answer = (True, work(item))
            except BaseException as error:  # whatever a user's code raises
                if not isinstance(error, (AssessmentError, UsageError)):
                    error.add_note("".join(traceback.format_exception(error)))
                answer = (False, error)
            try:
                connection.send(answer)
            except (OSError, BrokenPipeError):
                os._exit(1)
            except Exception:  # cannot be pickled
                connection.send((False, AssessmentError(f"{type(answer[1]).__name__} in a worker process")))


def _beat(parent: int, signs: Any, answer_limit: float) -> None:
    """Show that this worker lives, unless a controller does not answer; end it when its parent has been killed."""
    while os.getppid() == parent:
        since = guarded_controller.called_at
        signs[_CALLED] = since is not None
        if since is None or time.monotonic() - since < answer_limit:
            signs[_BEATS] += 1
        time.sleep(_BEAT)
    os._exit(1)


class _Worker:
    """One process, and what it is at."""

    def __init__(self, answer_limit: float) -> None:
        context = multiprocessing.get_context("fork")
        self.connection, theirs = context.Pipe()
        self.signs = RawArray("q", 2)
        self.process = context.Process(target=_serve, args=(theirs, self.signs, answer_limit))
        # Until the worker has settled what a signal means to it, it would do what it means to its parent.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
        try:
            self.process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
        self.at: deque[int] = deque()  # numbers of the items that it still has to finish
        self.finished = 0
        self.said_all = False  # its end of the pipe is closed
        self._beats, self._silent = -1, 0.0

    def silent_for(self, seconds: float) -> float:
        """Return for how long no heartbeat has come, s; to be asked regularly, with the time since the last asking."""
        beats = self.signs[_BEATS]
        self._silent = 0.0 if beats != self._beats else self._silent + seconds
        self._beats = beats
        return self._silent

    def end(self, *, at_once: bool) -> None:
        """End the process, whatever it does about it."""
        if at_once:
            self.process.kill()
        self.process.join(None if at_once else _PATIENCE)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        self.connection.close()


class WorkerPool:
    """Processes forked from this one, which do the same work on many items.

    Fork them before other threads start. One that replaces another later is forked beside the thread that draws the
    progress bar, of which it uses nothing.
    """

    def __init__(self, count: int, *, answer_limit: float = ANSWER_LIMIT) -> None:
        """Start `count` workers.

        Args:
            count: of processes.
            answer_limit: s that a call of a controller may take.
        """
        self._answer_limit = answer_limit
        self._failed_starts = 0
        self._workers: list[_Worker] = []
        atexit.register(self.close, wait=False)  # Python waits for its children at its end
        self._count = count
        self._fill()

    def _fill(self) -> None:
        """Start workers until there are as many as there should be."""
        while len(self._workers) < self._count:
            self._workers.append(_Worker(self._answer_limit))

    def map(
        self, work: Callable[[_Item], _Result], items: Sequence[_Item], lost: Callable[[_Item, str], _Result]
    ) -> Iterator[_Result]:
        """Do `work`, a function of a module, on every item and yield what it returns in the same order.

        Args:
            work: what it raises is raised here.
            items: what to work on.
            lost: what stands for the result of an item that a worker has not finished, for the reason given.

        Raises:
            AssessmentError: one worker after the other fails before it has finished anything.
        """
        results: dict[int, tuple[bool, Any]] = {}
        waiting = deque(range(len(items)))
        chunk = max(1, min(_LARGEST_CHUNK, len(items) // (4 * self._count)))
        asked = time.monotonic()
        try:
            for number in range(len(items)):
                while number not in results:
                    self._fill()
                    self._hand_out(work, items, waiting, chunk)
                    for worker in self._workers:
                        self._take(worker, results)
                    now = time.monotonic()
                    # Where this process was stopped as well, its own pause says nothing about them.
                    passed, asked = min(now - asked, 2.0 * _POLL), now
                    for worker in list(self._workers):
                        reason = self._trouble(worker, passed)
                        if reason and (worker.said_all or not worker.connection.poll()):
                            self._replace(worker, reason, items, waiting, results, lost)
                    if number not in results:
                        wait([worker.connection for worker in self._workers], _POLL)
                fine, answer = results.pop(number)
                if not fine:
                    raise answer
                yield answer
        finally:
            for worker in [worker for worker in self._workers if worker.at]:  # nobody takes its answers any more
                worker.end(at_once=True)
                self._workers.remove(worker)

    def _hand_out(self, work: Callable[[Any], Any], items: Sequence[Any], waiting: deque[int], chunk: int) -> None:
        for worker in self._workers:
            if waiting and not worker.at:
                numbers = [waiting.popleft() for _ in range(min(chunk, len(waiting)))]
                worker.at.extend(numbers)
                with contextlib.suppress(OSError):  # it has ended, as will be seen
                    worker.connection.send((work, [items[number] for number in numbers]))

    def _take(self, worker: _Worker, results: dict[int, tuple[bool, Any]]) -> None:
        """Take every answer that a worker has given."""
        try:
            while not worker.said_all and worker.connection.poll():
                answer = worker.connection.recv()
                results[worker.at.popleft()] = answer
                worker.finished += 1
                self._failed_starts = 0
        except (EOFError, OSError):
            worker.said_all = True
            worker.process.join(_PATIENCE)

    def _trouble(self, worker: _Worker, passed: float) -> str | None:
        """Return why a worker must be replaced; none where all is well."""
        process = worker.process
        if not process.is_alive():
            code = process.exitcode or 0
            how = f"was killed by {_signal_name(-code)}" if code < 0 else f"ended with exit code {code}"
            return abort_reason(AbortKind.ENDED, f"a worker process died: it {how}")
        silent = worker.silent_for(passed)
        if worker.at and silent > HEARTBEAT_LIMIT and not worker.signs[_CALLED]:
            return abort_reason(AbortKind.STOPPED, f"a worker process gave no sign of life for {HEARTBEAT_LIMIT:g} s")
        if worker.at and worker.signs[_CALLED] and silent > min(HEARTBEAT_LIMIT, self._answer_limit):
            return abort_reason(AbortKind.NO_ANSWER, f"no answer within {self._answer_limit:g} s")
        return None

    def _replace(
        self,
        worker: _Worker,
        reason: str,
        items: Sequence[Any],
        waiting: deque[int],
        results: dict[int, tuple[bool, Any]],
        lost: Callable[[Any, str], Any],
    ) -> None:
        worker.end(at_once=True)
        self._workers.remove(worker)
        if not worker.finished:
            self._failed_starts += 1
        if worker.at:
            culprit = worker.at.popleft()
            waiting.extendleft(reversed(worker.at))
            worker.at.clear()
            try:
                results[culprit] = (True, lost(items[culprit], reason))
            except AssessmentError as error:
                results[culprit] = (False, error)
        if self._failed_starts >= FAILED_STARTS:
            raise AssessmentError(f"{FAILED_STARTS} starts in a row failed, the last one so: {reason}")

    def close(self, *, wait: bool = True) -> None:
        """End the workers; what is under way is dropped unless `wait`."""
        for worker in self._workers:
            if wait:
                with contextlib.suppress(OSError):
                    worker.connection.send(None)
            else:
                worker.process.terminate()
        for worker in self._workers:
            worker.end(at_once=False)
        self._workers = []
        self._count = 0
        atexit.unregister(self.close)


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
