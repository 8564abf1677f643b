"""Keeps the process of a quick controller on the processor of whoever asks it.

One of both always waits for the other, so that two processors are no gain, and to wake a process on another one takes
several times as long as a short answer does. Whoever takes long may have threads of its own, and stays where it likes.
"""

from __future__ import annotations

import ctypes
import os
import time
from typing import Final

_CALLS: Final = 256
"""Calls between two decisions. The first of them are answered wherever the process is: threads that a controller starts
meanwhile may go where they like ever after."""
_QUICK: Final = 200e-6
"""s of an answer, in the mean of so many calls."""


class Nearby:
    """Where the process of a controller answers; on systems other than Linux nothing is done.

    Its first thread, which answers, is bound to the processor where it is asked. Who asks is bound to it only while it
    waits: left alone, the system would wake it on another one that has nothing to do.
    """

    def __init__(self, pid: int) -> None:
        """Leave the process `pid` where it is, as yet."""
        self._pid = pid
        self._calls, self._seconds, self._since = 0, 0.0, 0.0
        self._processor = -1  # to which it is bound
        self._allowed: set[int] = set()  # those of who asks; empty where nobody is bound
        self._able = hasattr(os, "sched_setaffinity")

    def begin_waiting(self) -> None:
        """Be told that the calling thread is about to ask, and to wait."""
        self._since = time.monotonic()
        if self._allowed:
            here = _current_processor()
            self._able = _bind(0, {here}) and (here == self._processor or _bind(self._pid, {here}))
            self._processor = here

    def end_waiting(self) -> None:
        """Be told by the same thread that it has been answered, or never will be."""
        if self._allowed:
            _bind(0, self._allowed)
        self._calls += 1
        self._seconds += time.monotonic() - self._since
        if self._calls == _CALLS and self._able:
            self._decide(quick=self._seconds < _QUICK * _CALLS)
            self._calls, self._seconds = 0, 0.0

    def _decide(self, *, quick: bool) -> None:
        allowed = os.sched_getaffinity(0)
        if quick and len(allowed) > 1:
            self._allowed = allowed
        elif self._allowed:
            self._allowed, self._processor = set(), -1
            _bind(self._pid, allowed)


def _bind(thread: int, processors: set[int]) -> bool:
    try:
        os.sched_setaffinity(thread, processors)
    except OSError:  # the process has ended, or the system forbids it
        return False
    return True


_current_processor = ctypes.CDLL(None).sched_getcpu if hasattr(os, "sched_setaffinity") else lambda: -1
