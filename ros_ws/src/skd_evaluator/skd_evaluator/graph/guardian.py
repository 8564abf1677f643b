"""A process that ends what this one has started, should this one be killed."""

from __future__ import annotations

import contextlib
import subprocess
import sys

_GRACE = 3.0
"""Seconds that it has to end."""

_GUARDIAN = """
import os, signal, sys
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, signal.SIG_IGN)
groups = set()
for line in sys.stdin:
    (groups.add if line[0] == "+" else groups.discard)(int(line[1:]))
for group in groups:
    try:
        os.killpg(group, signal.SIGKILL)
    except OSError:
        pass
"""
"""Is told of every process group, and kills those that are left when whoever told it is gone, by whatever death.

The kernel's own signal at the death of a parent reaches the processes started here, but not those that they start.
"""


class Guardian:
    """A small process that outlives this one, and ends when told to or when its work is done."""

    def __init__(self) -> None:
        self._popen = subprocess.Popen(
            [sys.executable, "-I", "-S", "-c", _GUARDIAN],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            text=True,
            start_new_session=True,
        )

    def tell(self, change: str, group: int) -> None:
        """Add (+) or remove (-) a process group."""
        assert self._popen.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._popen.stdin.write(f"{change}{group}\n")
            self._popen.stdin.flush()

    def stop(self) -> None:
        """Let it end."""
        with contextlib.suppress(subprocess.TimeoutExpired, BrokenPipeError):
            self._popen.communicate(timeout=_GRACE)
        self._popen.kill()
        self._popen.wait()
