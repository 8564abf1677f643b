"""Worker processes that may die, stop or fall silent: each is replaced, and what it was at is reported as lost.

Above each stands a keeper (`skd_evaluator.keeper`), which is what this process has forked: when a worker ends, or this
process, all that its controller has started ends with it.
"""

from __future__ import annotations

import atexit
import contextlib
import mmap
import multiprocessing
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future
from concurrent.futures import wait as wait_for
from multiprocessing.connection import Connection, wait
from typing import Any, NamedTuple, ParamSpec, TypeVar

from skd_sim.controllers.isolated import CALL_LIMIT, end_children, portable, set_call_limit
from skd_sim.episode.aborts import AbortKind, abort_reason
from skd_sim.program.interruption import SIGNALS

from skd_evaluator.errors import AssessmentError
from skd_evaluator.keeper import end_now, is_stopped, keep

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")

FAILED_STARTS = 3
"""So many workers in a row that end before they have finished anything end the work."""
HEARTBEAT_LIMIT = 20.0
"""s without a heartbeat, which beats twice a second, after which a worker is stopped or stuck."""
_BEAT = 0.5  # s
_POLL = 0.25  # s
_STOPPED_LIMIT = 1.0  # s without a heartbeat after which a worker that a signal has stopped is replaced
_PATIENCE = 1.0  # s for all workers to end by themselves, or after SIGTERM
_KEEPER_PATIENCE = 3.0  # s for a keeper to kill all that is below it
_FAULTS = {
    signal.SIGILL, signal.SIGTRAP, signal.SIGABRT, signal.SIGBUS, signal.SIGFPE, signal.SIGSEGV, signal.SIGSYS,
    signal.SIGXCPU, signal.SIGXFSZ,
}  # fmt: skip
"""What the system sends to who has done something wrong; who ends by any other signal was ended by somebody else."""

_BEATS, _DONE, _EVER, _PID = 0, 1, 2, 3
# What a worker writes: heartbeats, items finished of its task, and of all, and which process it is.
_SIGNS = 4


class _Here:
    """The worker that this process is, if it is one.

    Attributes:
        signs: array that this worker writes and its pool reads.
    """

    signs: Any = [0] * _SIGNS


def say_finished() -> None:
    """Say, in a worker, that an item of its task is finished: should it die, the next one is to blame."""
    _Here.signs[_DONE] += 1
    _Here.signs[_EVER] += 1


class LostWorkerError(Exception):
    """A worker ended in the middle of a task.

    Attributes:
        reason: why it ended, as the reason of an aborted episode; see `skd_sim.episode.aborts`.
        finished: number of items of the task that it had finished; None if it is not known.
        foreign: whether somebody else ended it, and not the item that it was working on.
    """

    def __init__(self, reason: str, finished: int | None, foreign: bool) -> None:
        """Keep what is known of the end."""
        super().__init__(reason, finished, foreign)
        self.reason, self.finished, self.foreign = reason, finished, foreign


def _serve(connection: Connection, signs: Any, answer_limit: float) -> None:
    """Work on tasks until there are no more; this runs in the worker, below its keeper."""
    with contextlib.suppress(OSError):
        os.setsid()  # who kills this process's group leaves the keepers to end the workers
    keep()
    _Here.signs = signs
    signs[_PID] = os.getpid()
    set_call_limit(answer_limit)
    # Ctrl-C reaches the whole process group; the parent alone decides how to end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    threading.Thread(target=_beat, args=(os.getppid(), signs), daemon=True).start()
    while (task := connection.recv()) is not None:
        signs[_DONE] = 0
        work, arguments, named = task
        try:
            answer = (True, work(*arguments, **named))
        except BaseException as error:  # whatever a user's code raises
            answer = (False, portable(error))
        try:
            connection.send(answer)
        except (OSError, BrokenPipeError):
            os._exit(1)
        except Exception:  # cannot be pickled
            connection.send((False, AssessmentError(f"{type(answer[1]).__name__} in a worker process")))
    end_children()


def _beat(parent: int, signs: Any) -> None:
    """Show that this worker lives; end it when its parent has been killed."""
    while os.getppid() == parent:
        signs[_BEATS] += 1
        time.sleep(_BEAT)
    os._exit(1)


class _Task(NamedTuple):
    future: Future[Any]
    call: tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]


class _Trouble(NamedTuple):
    """Why a worker has to be replaced, and whether somebody else ended it: if so, its item is done again."""

    reason: str
    foreign: bool


class _Worker:
    """One process, and the task that it is working on."""

    def __init__(self, answer_limit: float) -> None:
        context = multiprocessing.get_context("fork")
        self.connection, theirs = context.Pipe()
        # Memory of no file: multiprocessing's own arrays lie in /dev/shm, which may be full, or not be there.
        self.signs = memoryview(mmap.mmap(-1, 8 * _SIGNS)).cast("q")
        self.process = context.Process(target=_serve, args=(theirs, self.signs, answer_limit))
        # Until the worker has settled what a signal means to it, it would do what it means to its parent.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
        try:
            self.process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
        assert self.process.pid is not None
        self._keeper = self.process.pid
        self.task: _Task | None = None
        self.said_all = False  # its end of the pipe is closed
        self._beats, self._silent = -1, 0.0

    def silent_for(self, seconds: float) -> float:
        """Return for how long no heartbeat has come, s; to be asked regularly, with the time since the last asking."""
        beats = self.signs[_BEATS]
        self._silent = 0.0 if beats != self._beats else self._silent + seconds
        self._beats = beats
        return self._silent

    def has_ended(self, latest: float) -> bool:
        """Return whether worker and keeper have ended, or do until a time (monotonic, s)."""
        # `join` goes by a pipe that the worker closes; its keeper ends a moment later, or not at all if it is stopped.
        while self.process.exitcode is None:
            if time.monotonic() > latest:
                return False
            time.sleep(0.002)
        return True

    def ask_to_end(self) -> None:
        """Have the worker end as SIGTERM ends it."""
        with contextlib.suppress(OSError):
            os.kill(self.signs[_PID] or self._keeper, signal.SIGTERM)

    def end(self, latest: float = 0.0) -> None:
        """End the process and all that it has started, whatever they do about it.

        Args:
            latest: until when it may end by itself (monotonic, s); at once by default.
        """
        if self.process.exitcode is None:
            os.kill(self._keeper, signal.SIGCONT)  # a keeper that is stopped would never end
        if not self.has_ended(latest):
            end_now(self._keeper)
            if not self.has_ended(time.monotonic() + _KEEPER_PATIENCE):
                self.process.kill()
        self.process.join()
        self.connection.close()


class WorkerPool(Executor):
    """An executor of processes forked from this one.

    Make it before other threads start. A worker that replaces another later is forked beside the other threads, of
    which it uses nothing. A thread of the pool's own hands out tasks and looks after the workers.

    Attributes:
        answer_limit: time that a call of a controller may take, s.
    """

    def __init__(self, count: int, *, answer_limit: float = CALL_LIMIT) -> None:
        """Start `count` workers.

        Args:
            count: number of processes.
            answer_limit: time that a call of a controller may take, s.
        """
        self.answer_limit = answer_limit
        self._failed_starts = 0
        self._waiting: deque[_Task] = deque()
        self._open: set[Future[Any]] = set()
        self._closed = False
        self._lock = threading.Lock()  # of what is waiting, and of whether this is closed
        self._listen, self._wake = os.pipe()
        self._workers: list[_Worker] = []
        atexit.register(self.shutdown, wait=False)  # Python waits for its children at its end
        self._count = count
        self._manager = threading.Thread(target=self._manage, name="skd-workers", daemon=True)
        try:
            self._fill()
            self._manager.start()
        except BaseException:  # no descriptor, memory or process is left for another one
            self.shutdown(wait=False)
            raise

    def _fill(self) -> None:
        """Start workers until there are as many as there should be."""
        while len(self._workers) < self._count:
            self._workers.append(_Worker(self.answer_limit))

    def submit(
        self, fn: Callable[_Arguments, _Result], /, *args: _Arguments.args, **kwargs: _Arguments.kwargs
    ) -> Future[_Result]:
        """Have a worker call a function of a module; see `Executor.submit`.

        The future's exception is a LostWorkerError where the worker ends in the middle, and an AssessmentError where
        one worker after the other does before it has finished anything.
        """
        future: Future[_Result] = Future()
        with self._lock:
            if self._closed:
                raise BrokenExecutor("the workers have ended")
            self._waiting.append(_Task(future, (fn, args, kwargs)))
            self._open.add(future)
            os.write(self._wake, b"\0")
        future.add_done_callback(self._open.discard)
        return future

    def _manage(self) -> None:
        asked = time.monotonic()
        try:
            while not self._closed:
                at_work = [worker.connection for worker in self._workers if worker.task]
                for ready in wait([self._listen, *at_work], _POLL if at_work else None):
                    if ready == self._listen:
                        os.read(self._listen, 4096)
                now = time.monotonic()
                # Where this process was stopped as well, its own pause says nothing about them.
                passed, asked = min(now - asked, 2.0 * _POLL), now
                for worker in list(self._workers):
                    self._take(worker)
                    trouble = self._trouble(worker, passed)
                    if trouble and (worker.said_all or not worker.connection.poll()):
                        self._replace(worker, trouble)
                self._hand_out()
        except Exception as error:  # no memory or process left for another worker, most likely
            with self._lock:
                self._closed = True
            self._give_up(BrokenExecutor(f"the worker processes ended with {type(error).__name__}: {error}"))

    def _hand_out(self) -> None:
        if not self._waiting:
            return
        self._fill()
        for worker in self._workers:
            while worker.task is None and (task := self._next()) is not None:
                if not task.future.set_running_or_notify_cancel():
                    continue
                worker.task, worker.signs[_DONE] = task, 0
                try:
                    worker.connection.send(task.call)
                except OSError:
                    pass  # it has ended, as will be seen
                except Exception as error:  # cannot be pickled
                    worker.task = None
                    task.future.set_exception(error)

    def _next(self) -> _Task | None:
        with self._lock:
            return self._waiting.popleft() if self._waiting else None

    def _take(self, worker: _Worker) -> None:
        """Take the answer of a worker, if it has given one."""
        try:
            while not worker.said_all and worker.connection.poll():
                fine, answer = worker.connection.recv()
                task, worker.task = worker.task, None
                self._failed_starts = 0
                assert task is not None
                if fine:
                    task.future.set_result(answer)
                else:
                    task.future.set_exception(answer)
        except (EOFError, OSError):
            worker.said_all = True
            worker.has_ended(time.monotonic() + _PATIENCE)

    def _trouble(self, worker: _Worker, passed: float) -> _Trouble | None:
        """Return why a worker must be replaced; none where all is well."""
        process = worker.process
        if not process.is_alive():
            code = process.exitcode or 0
            how = f"was killed by {_signal_name(-code)}" if code < 0 else f"ended with exit code {code}"
            foreign = code < 0 and -code not in _FAULTS
            return _Trouble(abort_reason(AbortKind.ENDED, f"a worker process died: it {how}"), foreign)
        silent = worker.silent_for(passed)
        if not worker.task:
            return None
        if silent > _STOPPED_LIMIT and is_stopped(worker.signs[_PID]):
            return _Trouble(abort_reason(AbortKind.STOPPED, "a worker process was stopped by a signal"), True)
        if silent > HEARTBEAT_LIMIT:
            how = f"a worker process gave no sign of life for {HEARTBEAT_LIMIT:g} s"
            return _Trouble(abort_reason(AbortKind.STOPPED, how), True)
        return None

    def _replace(self, worker: _Worker, trouble: _Trouble) -> None:
        worker.end()
        self._workers.remove(worker)
        self._failed_starts = 0 if worker.signs[_EVER] else self._failed_starts + 1
        if worker.task is None:
            return
        error: Exception = LostWorkerError(trouble.reason, worker.signs[_DONE], trouble.foreign)
        if self._failed_starts >= FAILED_STARTS:
            error = AssessmentError(f"{FAILED_STARTS} starts in a row failed, the last one so: {trouble.reason}")
        worker.task.future.set_exception(error)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the workers; what is under way is dropped unless `wait`.

        Args:
            wait: whether to wait for what has begun, and, unless `cancel_futures`, for what has not.
            cancel_futures: whether what has not begun is dropped.
        """
        if cancel_futures or not wait:
            with self._lock:
                dropped = list(self._waiting)
                self._waiting.clear()
            for task in dropped:
                task.future.cancel()
        if wait and not self._closed:
            wait_for(list(self._open))
        with self._lock:
            self._closed = True
            if self._wake < 0:
                return
            os.write(self._wake, b"\0")
        if self._manager.ident is not None:
            self._manager.join()
        for worker in self._workers:
            if wait:
                with contextlib.suppress(OSError):
                    worker.connection.send(None)
            else:
                worker.ask_to_end()
        latest = time.monotonic() + _PATIENCE
        for worker in self._workers:
            worker.end(latest)
        self._give_up(BrokenExecutor("the workers have ended"))
        self._workers = []
        ends, self._listen, self._wake = (self._listen, self._wake), -1, -1
        for one in ends:  # each is closed once, also where an interrupt comes in between
            os.close(one)
        atexit.unregister(self.shutdown)

    def _give_up(self, error: Exception) -> None:
        """Tell whoever still waits for something."""
        for task in [task for task in (*self._waiting, *(worker.task for worker in self._workers)) if task]:
            if not task.future.done():
                task.future.set_exception(error)
        self._waiting.clear()


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
