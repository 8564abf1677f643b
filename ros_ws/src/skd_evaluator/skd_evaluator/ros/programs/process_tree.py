"""Processes by a mark in their environment: children of children too, whatever their session and their parent."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from pathlib import Path

MARK = "SKD_GRAPH_PROCESS"
"""Environment variable of all that a graph starts; a child inherits it unless it is given an empty environment."""
_PATIENCE = 3.0
"""Seconds in which what is killed has to be gone."""


def marked(mark: str) -> list[int]:
    """Return the ids of the living processes whose mark begins so; zombies are not among them (Linux only)."""
    wanted = f"{MARK}={mark}".encode()
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            with contextlib.suppress(OSError):  # it has ended, or is somebody else's
                if any(one.startswith(wanted) for one in (entry / "environ").read_bytes().split(b"\0")):
                    found.append(int(entry.name))
    return found


def is_stopped(pid: int) -> bool:
    """Whether a process is stopped by a signal, as by SIGSTOP; one under a debugger is not."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[:1] == [b"T"]
    return False


def kill_marked(mark: str) -> None:
    """Kill all that bears a mark, and what it starts meanwhile."""
    end = time.monotonic() + _PATIENCE
    while (left := marked(mark)) and time.monotonic() < end:
        for pid in left:
            with contextlib.suppress(OSError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(0.01)
