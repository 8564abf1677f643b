"""How a program ends: SIGINT and SIGTERM as an exception that is also remembered, and an end that comes in time.

Code of others may swallow the exception. A middleware may hang while a node is taken down, in a loop that holds
Python's global lock (eProsima/Fast-DDS issue 6513): no Python thread and no signal handler of Python's runs then. A
timer of the C library needs neither: its thread calls `_exit`. Imports nothing that takes time, for programs begin with
it.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import struct
import sys
import threading
import time
from collections.abc import Callable
from types import FrameType, TracebackType

END_LIMIT = 1.5
"""Seconds that taking a node down may take, and Python's own end after it."""
_CLOCK_MONOTONIC, _SIGEV_THREAD = 1, 2
_SIGEVENT, _ITIMERSPEC = "QiiQ40x", "qqqq"
"""Linux's `sigevent` (value, signal, how, function) and `itimerspec` (period and first time, each s and ns)."""


def end_within(seconds: float, code: int) -> contextlib.AbstractContextManager[object]:
    """End this process after a time, at once and whatever it does; write all that is to be kept before.

    Args:
        seconds: time from now, s.
        code: exit code of the process.

    Returns:
        What takes that back at the end of a `with` statement; without one it stands.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):  # closed, or without a reader
            stream.flush()
    ending = contextlib.ExitStack()
    try:
        libc, timer = ctypes.CDLL(None), ctypes.c_void_p()
        leave = ctypes.cast(libc._exit, ctypes.c_void_p).value
        event = struct.pack(_SIGEVENT, code, 0, _SIGEV_THREAD, leave)
        first = struct.pack(_ITIMERSPEC, 0, 0, *divmod(int(seconds * 1e9), 10**9))
        if not libc.timer_create(_CLOCK_MONOTONIC, event, ctypes.byref(timer)):
            libc.timer_settime(timer, 0, first, None)
            ending.callback(libc.timer_delete, timer)
    except (OSError, AttributeError):  # another C library
        pass
    return ending


SIGNALS = (signal.SIGINT, signal.SIGTERM)
_CALLED_BY_MACHINE_CODE = {
    ("llvmlite.binding.executionengine", "_raw_object_cache_getbuffer"),
    ("llvmlite.binding.executionengine", "_raw_object_cache_notify"),
    ("ctypes", "cast"),
}
"""Modules and functions that no exception may leave, or the process ends by SIGSEGV.

LLVM calls the first two for code that is read from the cache. What leaves them is lost, and so is the code: its address
is 0, to which numba writes (`set_env`). The last is called whenever a kernel is handed a random generator; the kernel
does not look whether it gave anything (`unbox_numpy_random_bitgenerator`).
"""
_NOBODY_LISTENS = "ignored due to race condition"
"""What Python says of a signal that comes while it is set to be ignored (`_PyErr_CheckSignalsTstate`, CPython)."""
_AGAIN = 0.02  # s until a signal that came in one of them is sent again


class Interrupted(KeyboardInterrupt):
    """One of the signals has come.

    A class of its own, because Python kills itself at its end, silently, where a plain KeyboardInterrupt has left an
    `exec` of a text, as in the making of a dataclass, even if it was caught later (`run_eval_code_obj` in CPython).
    """


class Interruption:
    """Listens to both signals.

    Attributes:
        came: whether one has come.
        held: if set, further signals are only remembered, while there is something to clean up.
    """

    def __init__(self, cleaning: float = 0.0) -> None:
        """Begin to listen with `listen` or a `with` statement.

        Args:
            cleaning: s after one has come in which another does nothing: who presses Ctrl-C twice, or is ended by
                SIGINT and SIGTERM, would break off what the first one has to clean up. Later another one does.
        """
        self.came = False
        self._cleaning, self._cleans_until = cleaning, 0.0
        self.held = False
        self._last: int = signal.SIGTERM
        self._before: dict[int, Callable[[int, FrameType | None], object] | int | None] = {}
        self._say = sys.excepthook
        self._say_lost = sys.unraisablehook

    def listen(self) -> None:
        """Begin to listen; a signal that was ignored when this process was started stays ignored."""
        if threading.current_thread() is not threading.main_thread():
            return  # Python allows it nowhere else
        sys.excepthook, sys.unraisablehook = self._on_error, self._on_lost
        for number in SIGNALS:
            if signal.getsignal(number) is not signal.SIG_IGN:
                self._before[number] = signal.signal(number, self._on_signal)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self.came = True
        if self.held or time.monotonic() < self._cleans_until:
            return
        self._last = number
        if _called_by_machine_code(frame):
            self._send_again()
            return
        self._cleans_until = time.monotonic() + self._cleaning
        raise Interrupted

    def _send_again(self) -> None:
        again = threading.Timer(_AGAIN, os.kill, (os.getpid(), self._last))
        again.daemon = True
        again.start()

    def _on_error(self, kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        """Print nothing if a signal makes the import of a compiled module fail: numpy's modules would print it."""
        if not isinstance(error, Interrupted):
            self._say(kind, error, trace)

    def _on_lost(self, error: sys.UnraisableHookArgs) -> None:
        """Send a signal again, without a word, that came where no exception can leave, as in a callback or a `__del__`.

        That is where the first one sent again may come, on a busy machine: in another of LLVM's callbacks.
        """
        if not isinstance(error.exc_value, Interrupted):
            if not (self.held and _NOBODY_LISTENS in str(error.exc_value)):
                self._say_lost(error)
        elif not self.held:
            self._cleans_until = 0.0
            self._send_again()

    def leave(self, code: int) -> None:
        """Say that nothing is left to do but Python's own end, which another signal must not turn into a failure.

        Ctrl-C comes twice below `ros2 launch`: from the terminal and from the launch. What is ignored stays so to the
        last; a handler would be taken away before the end. SIGTERM ends the process at once, should its end hang.
        """
        self.held = True
        if signal.SIGINT in self._before:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        if signal.SIGTERM in self._before:
            signal.signal(signal.SIGTERM, lambda _number, _frame: os._exit(code))

    def __enter__(self) -> Interruption:
        self.listen()
        return self

    def __exit__(self, *_error: object) -> None:
        if threading.current_thread() is threading.main_thread():
            sys.excepthook, sys.unraisablehook = self._say, self._say_lost
        for number, handler in self._before.items():
            signal.signal(number, handler)


def _called_by_machine_code(frame: FrameType | None) -> bool:
    """Whether what a signal has interrupted is called by machine code that takes no exception."""
    while frame is not None:
        if (frame.f_globals.get("__name__"), frame.f_code.co_name) in _CALLED_BY_MACHINE_CODE:
            return True
        frame = frame.f_back
    return False
