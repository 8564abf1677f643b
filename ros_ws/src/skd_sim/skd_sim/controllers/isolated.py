"""A child process for third-party code: a user's controller, or a simulator that is not SKD's.

Whole pieces of work run in the child: an episode, a crossing, the search of a trial. No call of a controller crosses a
process, so a user's controller is as quick as one of SKD's own. The child may crash, hang, or leave processes behind:
the caller gets a `LostProcessError`, all of the child's process group is killed, and the next piece of work begins
another child.
"""

from __future__ import annotations

import contextlib
import gc
import io
import mmap
import os
import pickle
import select
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection, Pipe
from typing import Any, Final, NoReturn, TypeVar

import numpy as np

from skd_sim.errors import AssessmentError, UsageError
from skd_sim.world.episode import AbortKind, abort_reason

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

CALL_LIMIT: Final = 60.0
"""s that a call of a controller may take unless `set_call_limit` says otherwise."""
LOADING: Final = 10.0
"""Times as long the loading of a controller may take: it may read a large network."""
FAILED_STARTS: Final = 3
"""So many children in a row that are lost in their first piece of work end the assessment."""
_SLOW: Final = 10.0  # s after which a line warns of a call that has not returned
_POLL: Final = 0.25  # s between two looks at whether the child lives and its call is in time
_PATIENCE: Final = 1.0  # s for a child whose pipe is closed to end by itself, so that its exit code is seen

# A forked process keeps its parent's garbage: an rclpy node in it, taken down without DDS's threads, ends in SIGSEGV.
os.register_at_fork(after_in_child=gc.freeze)


class LostProcessError(AssessmentError):
    """The child ended, or a call in it took too long.

    Attributes:
        reason: why, as the reason of an aborted episode.
    """

    def __init__(self, reason: str) -> None:
        """Keep the reason."""
        super().__init__(reason)
        self.reason = reason


class _Here:
    """What this process knows.

    Attributes:
        limit: time that a call of a controller may take, s.
        call: in a child, memory that its parent reads: until when the call that it is in may take (`time.monotonic`, 0
            outside of calls), and how long it may take, s.
        is_child: whether this process is a child.
        children: children by the name of whose code they run.
        owner: id of the process whose children these are.
        failed: how many children in a row were lost in their first piece of work.
        warned: whether it has warned of a slow call.
    """

    limit = CALL_LIMIT
    call: Any = np.zeros(2)
    is_child = False
    children: Final[dict[str, IsolatedProcess]] = {}
    owner = 0
    failed = 0
    warned = False


def set_call_limit(seconds: float) -> None:
    """Set how long a call of a controller may take; for children that begin later, too."""
    if seconds != _Here.limit:
        end_children()
        _Here.limit = seconds


def begin_call(factor: float = 1.0) -> None:
    """Note that a call of a user's code begins: a child is killed if it does not end in time.

    Args:
        factor: times as long as a call of a controller it may take.
    """
    call = _Here.call
    call[1] = allowed = factor * _Here.limit
    call[0] = time.monotonic() + allowed


def end_call() -> None:
    """Note that the call has ended."""
    _Here.call[0] = 0.0


def isolated(whose: str, work: Callable[[_Item], _Result], item: _Item) -> _Result:
    """Return `work(item)`, done in the child that this process keeps for a user's code.

    Args:
        whose: name of the controller or simulator; empty where all code is SKD's own: the work is then done here, as it
            is in a child.
        work: a function of a module.
        item: what it is called with.

    Raises:
        LostProcessError: the child ended or hung; the next piece of work gets another one.
        AssessmentError: several children in a row were lost in their first piece of work.
    """
    (result,) = isolated_each(whose, work, (item,), _raise)
    return result


def isolated_each(
    whose: str, work: Callable[[_Item], _Result], items: Sequence[_Item], lost: Callable[[_Item, str], _Result]
) -> Iterator[_Result]:
    """Yield `work` of each item as `isolated` returns it; all items are sent at once, which costs far less.

    Args:
        whose: as of `isolated`.
        work: a function of a module.
        items: what it is called with.
        lost: what stands for the result of an item in which a child was lost, for the reason given; another child does
            the rest.
    """
    if not whose or _Here.is_child:
        yield from map(work, items)
        return
    children = _Here.children
    if _Here.owner != os.getpid():  # this process was forked, and they are its parent's
        children.clear()
        _Here.owner, _Here.failed = os.getpid(), 0
    done = 0
    while done < len(items):
        child = children.pop(whose, None) or IsolatedProcess(whose)
        try:
            for result in child.run_each(work, items[done:]):
                done, _Here.failed = done + 1, 0
                yield result
        except LostProcessError as error:
            _Here.failed = 0 if child.done else _Here.failed + 1
            if _Here.failed >= FAILED_STARTS:
                _Here.failed = 0
                what = f"{FAILED_STARTS} episodes in a row failed, the last one so: {error.reason}"
                raise AssessmentError(what) from None
            done += 1
            yield lost(items[done - 1], error.reason)
        finally:
            if child.is_open:
                children[whose] = child


def _raise(_item: object, reason: str) -> NoReturn:
    raise LostProcessError(reason)


def end_children() -> None:
    """End the children that this process keeps."""
    if _Here.owner == os.getpid():
        for child in _Here.children.values():
            child.close()
    _Here.children.clear()


class IsolatedProcess:
    """A child process, forked from this one, that does one piece of work after the other.

    Fork it before this process has other threads that hold locks. It ends when this object is closed, or this process
    ends, by whatever death; its process group is killed then.

    Attributes:
        pid: its id, and that of its process group.
        done: how many pieces of work it has finished.
        is_open: whether it can be given more.
    """

    def __init__(self, whose: str = "") -> None:
        """Fork it.

        Args:
            whose: whose code it runs, for messages.
        """
        self._whose, self.done, self.is_open = whose, 0, True
        self._code = 0
        self._connection, theirs = Pipe()
        self._call = memoryview(mmap.mmap(-1, 16)).cast("d")
        parent = os.getpid()
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(Exception):  # what is buffered must not be written twice
                stream.flush()
        self.pid = os.fork()
        if self.pid == 0:
            self._connection.close()
            _serve(theirs, self._call, parent)
        theirs.close()
        self._answers = select.poll()
        self._answers.register(self._connection, select.POLLIN)

    def run(self, work: Callable[[_Item], _Result], item: _Item) -> _Result:
        """Have it do a piece of work; what that raises is raised here.

        Raises:
            LostProcessError: it ended, or a call of a controller took too long.
        """
        (result,) = self.run_each(work, (item,))
        return result

    def run_each(self, work: Callable[[_Item], _Result], items: Sequence[_Item]) -> Iterator[_Result]:
        """Have it do pieces of work one after the other, as far as the first that raises, which is raised here.

        Raises:
            LostProcessError: it ended, or a call of a controller took too long.
        """
        fine = True
        value: Any = None
        try:
            self._connection.send_bytes(pickle.dumps((work, items), protocol=pickle.HIGHEST_PROTOCOL))
            for _ in items:
                self._await()
                fine, value = self._connection.recv()
                self.done += 1
                if not fine:
                    break
                yield value
        except (EOFError, ConnectionError):
            code = self.close(_PATIENCE)
            how = f"was killed by {_name_of_signal(-code)}" if code < 0 else f"ended with exit code {code}"
            self._lose(AbortKind.ENDED, f"its process {how}")
        except BaseException:
            self.close()
            raise
        if not fine:
            raise value

    def _await(self) -> None:
        while not self._answers.poll(1000.0 * _POLL):
            if self._has_ended():
                raise EOFError  # a process that it has left may hold its end of the pipe
            end, allowed = self._call
            taken = time.monotonic() - end + allowed if end else 0.0
            if taken > allowed:
                self._lose(AbortKind.NO_ANSWER, f"a call took more than {allowed:g} s")
            if taken > _SLOW and not _Here.warned:
                _Here.warned = True
                what = f"skd: a call of {self._whose} has taken {_SLOW:g} s; after {allowed:g} s its episode is aborted"
                print(what, file=sys.stderr)

    def _lose(self, kind: AbortKind, what: str) -> NoReturn:
        self.close()
        raise LostProcessError(abort_reason(kind, f"{what} ({self._whose})" if self._whose else what))

    def close(self, patience: float = 0.0) -> int:
        """End it, and kill its process group; return its exit code, as subprocess has it.

        Args:
            patience: time that it may take to end by itself, s.
        """
        if not self.is_open:
            return self._code
        self.is_open = False
        self._connection.close()
        latest = time.monotonic() + patience
        while not (ended := self._has_ended()) and time.monotonic() < latest:
            time.sleep(0.001)
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.pid, signal.SIGKILL)
        if not ended:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)  # it may have no group of its own yet
        with contextlib.suppress(ChildProcessError):
            self._code = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        return self._code

    def _has_ended(self) -> bool:
        try:
            return bool(os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT))
        except ChildProcessError:  # where SIGCHLD is ignored
            return True


def portable(error: BaseException) -> BaseException:
    """Return an error that can be sent to another process: with its traceback as text, unless it is one of ours."""
    if not isinstance(error, (AssessmentError, UsageError)):
        error.add_note("".join(traceback.format_exception(error)))
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return AssessmentError(f"{type(error).__name__} in another process: {error}")
    return error


def _serve(connection: Connection, call: Any, parent: int) -> NoReturn:
    """Work until the connection is closed; then kill this process and all others of its group: in the child."""
    try:
        os.setsid()  # Ctrl-C reaches the parent alone; what is started here can be killed as a group
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_SETMASK, ())
        _redirect()
        np.random.seed()  # noqa: NPY002 - Python's own generator is seeded anew by a fork, numpy's is not
        _Here.is_child, _Here.call = True, call
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
        while True:
            work, items = connection.recv()
            for item in items:
                answer: tuple[bool, Any]
                try:
                    answer = True, work(item)
                except BaseException as error:  # a user's code may raise anything
                    answer = False, portable(error)
                try:
                    connection.send(answer)
                except (pickle.PicklingError, AttributeError, TypeError) as error:
                    answer = False, AssessmentError(f"a result cannot be sent: {error}")
                    connection.send(answer)
                if not answer[0]:
                    break
    except (EOFError, OSError):
        pass
    except BaseException:
        traceback.print_exc()
    finally:
        with contextlib.suppress(BaseException):
            os.killpg(0, signal.SIGKILL)
        os._exit(1)


def _redirect() -> None:
    """Have what is printed here go to standard error, and nothing be read from the terminal."""
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.dup2(2, 1)
    sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", 1, encoding="utf-8", errors="backslashreplace", closefd=False)  # noqa: SIM115
    sys.stdout = _FirstLines(sys.stderr.buffer, "utf-8", "backslashreplace", line_buffering=True)


class _FirstLines(io.TextIOWrapper):
    """Passes on the first lines that a child prints: a car may print one at each command."""

    left = 100

    def write(self, text: str) -> int:
        if self.left > 0:
            super().write(text)
            self.left -= text.count("\n")
            if self.left <= 0:
                super().write("skd: what the car prints further is not shown\n")
        return len(text)


def _end_with(parent: int) -> None:
    """Kill this process and its group when its parent is gone, whatever it is at."""
    while os.getppid() == parent:
        time.sleep(_POLL)
    os.killpg(0, signal.SIGKILL)


def _name_of_signal(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
