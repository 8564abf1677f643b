"""Runs a function in a child of its own, with a limit of time, and says how it ended and what it took."""

from __future__ import annotations

import io
import os
import pickle
import resource
import select
import signal
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Ended:
    """How a function ended in its child.

    Attributes:
        value: what it returned; none where it did not.
        said: what it wrote to standard error.
        traceback: of an exception that left it; empty: none did.
        in_time: whether it ended by itself.
        memory: most memory that the child had, beyond what it began with, bytes.
        resident: the same, with what it began with.
        seconds: wall time.
    """

    value: Any
    said: str
    traceback: str
    in_time: bool
    memory: int
    resident: int
    seconds: float


def watched(function: Callable[[], Any], *, seconds: float, memory: int | None = None) -> Ended:
    """Run a function in a forked child.

    Args:
        function: what to run; what it returns must be picklable.
        seconds: after which the child is killed.
        memory: bytes that the child may allocate beyond what it has; by default what there is.
    """
    reading, writing = os.pipe()
    begin = time.monotonic()
    child = os.fork()
    if child == 0:
        os.close(reading)
        _report(function, writing, memory)
    os.close(writing)
    parts: list[bytes] = []
    in_time = True
    while True:
        left = begin + seconds - time.monotonic()
        if left <= 0.0 or not select.select([reading], [], [], left)[0]:
            os.kill(child, signal.SIGKILL)
            in_time = False
            break
        part = os.read(reading, 1 << 16)
        if not part:
            break
        parts.append(part)
    os.close(reading)
    _, status, _ = os.wait4(child, 0)
    took = time.monotonic() - begin
    if not in_time or status != 0:
        why = "" if not in_time else f"the child ended with status {status}"
        return Ended(None, "", why, in_time, 0, 0, took)
    return Ended(*pickle.loads(b"".join(parts)), took)


def _report(function: Callable[[], Any], pipe: int, memory: int | None) -> None:
    """Run it in the child and send what came of it; does not return."""
    status = 1
    try:
        if memory is not None:
            limit = _now("VmSize") + memory
            resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        # The peak that it has from its parent is none of its own.
        Path("/proc/self/clear_refs").write_text("5")
        before = _now("VmRSS")
        sys.stderr = said = io.StringIO()
        sys.stdout = io.StringIO()
        value, trace = None, ""
        try:
            value = function()
        except BaseException:
            trace = traceback.format_exc()
        peak = _now("VmHWM")
        message = pickle.dumps((value, said.getvalue(), trace, True, peak - before, peak))
        while message:
            message = message[os.write(pipe, message) :]
        status = 0
    finally:
        os._exit(status)


def _now(name: str) -> int:
    """Return a figure of /proc/self/status, bytes."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith(name))
