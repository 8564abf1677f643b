"""The end of a process that was forked from a benchmark and leads a session of its own."""

from __future__ import annotations

import os
import signal
import time


def end_of(child: int, limit: float) -> int | None:
    """Wait for a process; return its exit code, or None where it had to be ended, with all of its group.

    Args:
        child: its number, which is that of its group.
        limit: s after which it is ended.
    """
    latest = time.monotonic() + limit
    while time.monotonic() < latest:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.01)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None
