"""Work that a second core does meanwhile: in a process forked from this one, of which nothing but files is left."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from types import TracebackType
from typing import Self

from skd_sim.program.ending import end_with_parent


class Beside:
    """Something that is done in another process, from the time at which this object is made.

    That process says nothing: whoever waits and hears that it failed does the work again, and meets the error. It ends
    with this one, and with the block of a `with`. Begin it before other threads start: a process with threads is not
    safe to fork.
    """

    def __init__(self, work: Callable[[], None]) -> None:
        """Begin the work."""
        parent = os.getpid()
        self._child: int | None = os.fork() or None
        if self._child is None:
            _do(work, parent)

    def wait(self) -> bool:
        """Wait for its end; return whether the work is done."""
        if self._child is None:
            return False
        _, status = os.waitpid(self._child, 0)
        self._child = None
        return status == 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._child is not None:
            os.kill(self._child, signal.SIGKILL)
            self.wait()


def _do(work: Callable[[], None], parent: int) -> None:
    """Do the work in the new process, and end it."""
    code = 1
    try:
        end_with_parent()
        if os.getppid() != parent:  # it has ended before that
            return
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for stream in (1, 2):
            os.dup2(nowhere, stream)
        work()
        code = 0
    finally:
        os._exit(code)
