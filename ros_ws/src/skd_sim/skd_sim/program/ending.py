"""An end of this process that comes in time and with its exit code, whatever hangs in it.

A middleware may hang while a node is taken down, in a loop that holds Python's global lock (eProsima/Fast-DDS issue
6513): no Python thread and no signal handler of Python's runs then. A timer of the C library needs neither: its thread
calls `_exit`.
"""

from __future__ import annotations

import contextlib
import ctypes
import sys
from collections.abc import Iterator

END_LIMIT = 1.5
"""Seconds that taking a node down may take, and Python's own end after it."""
_CLOCK_MONOTONIC, _SIGEV_THREAD = 1, 2


class _Event(ctypes.Structure):
    """`struct sigevent` of Linux: 64 bytes, of which only these are used."""

    _fields_ = (
        ("value", ctypes.c_void_p),
        ("signo", ctypes.c_int),
        ("notify", ctypes.c_int),
        ("function", ctypes.c_void_p),
        ("attributes", ctypes.c_void_p),
        ("rest", ctypes.c_byte * 32),
    )


class _Setting(ctypes.Structure):
    """`struct itimerspec`: period and first time, each in seconds and nanoseconds."""

    _fields_ = (
        ("period", ctypes.c_long),
        ("period_nanoseconds", ctypes.c_long),
        ("first", ctypes.c_long),
        ("first_nanoseconds", ctypes.c_long),
    )


def end_within(seconds: float, code: int) -> contextlib.AbstractContextManager[None]:
    """End this process after a time, at once and whatever it does; write all that is to be kept before.

    Args:
        seconds: time from now, s.
        code: exit code of the process.

    Returns:
        What takes that back at the end of a `with` statement; without one it stands.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):  # closed, or nobody reads it
            stream.flush()
    try:
        libc = ctypes.CDLL(None)
        timer = ctypes.c_void_p()
        leave = ctypes.cast(libc._exit, ctypes.c_void_p)
        event = _Event(value=code, notify=_SIGEV_THREAD, function=leave.value)
        whole = int(seconds)
        setting = _Setting(first=whole, first_nanoseconds=int((seconds - whole) * 1e9))
        if libc.timer_create(_CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(timer)):
            raise OSError
        if libc.timer_settime(timer, 0, ctypes.byref(setting), None):
            raise OSError
    except (OSError, AttributeError):  # another C library
        return contextlib.nullcontext()
    return _deleting(libc, timer)


@contextlib.contextmanager
def _deleting(libc: ctypes.CDLL, timer: ctypes.c_void_p) -> Iterator[None]:
    try:
        yield
    finally:
        libc.timer_delete(timer)
