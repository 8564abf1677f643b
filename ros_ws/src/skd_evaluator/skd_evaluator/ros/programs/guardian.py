"""A process that ends what this one has started, should this one be killed."""

from __future__ import annotations

import contextlib
import subprocess
import sys

from skd_evaluator.ros.programs.process_tree import MARK

_GRACE = 3.0
"""Seconds that it has to end."""

_GUARDIAN = """
import os, signal, sys, time
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, signal.SIG_IGN)
groups = set()
for line in sys.stdin:
    (groups.add if line[0] == "+" else groups.discard)(int(line[1:]))
latest = time.monotonic() + 3.0
for group in groups:  # whose first process is a keeper: it finds what hides
    for number in (signal.SIGHUP, signal.SIGCONT):
        try:
            os.kill(group, number)
        except OSError:
            pass
for group in groups:
    try:
        while time.monotonic() < latest:
            os.kill(group, 0)
            time.sleep(0.01)
        os.killpg(group, signal.SIGKILL)
    except OSError:
        pass
mark = sys.argv[1].encode()
for attempt in range(100):
    left = False
    for pid in filter(str.isdecimal, os.listdir("/proc")):
        try:
            with open("/proc/" + pid + "/environ", "rb") as file:
                if any(one.startswith(mark) for one in file.read().split(b"\\0")):
                    left = True
                    os.kill(int(pid), signal.SIGKILL)
        except OSError:
            pass
    if not left:
        break
    time.sleep(0.02)
"""
"""Is told of every process group, and has their keepers end those that are left when whoever told it is gone, by
whatever death, or kills them; and then all processes that bear the mark, which may have sessions of their own.

The kernel's own signal at the death of a parent reaches the processes started here, but not those that they start.
"""


class Guardian:
    """A small process that outlives this one, and ends when told to or when its work is done."""

    def __init__(self, mark: str) -> None:
        """Start it.

        Args:
            mark: text by which the processes to be ended are known: each has it in its environment; see `process_tree`.
        """
        self._popen = subprocess.Popen(
            [sys.executable, "-I", "-S", "-c", _GUARDIAN, f"{MARK}={mark}"],
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
