"""Opening files that somebody else wrote, and what to call folders."""

from __future__ import annotations

import os
import stat
from collections.abc import Sequence
from pathlib import Path
from typing import IO

from skd_sim.errors import UsageError


def open_regular(path: Path) -> IO[bytes]:
    """Open a regular file for reading; anything else may never end, or never begin.

    Raises:
        UsageError: it cannot be opened, or is a pipe, a device, a socket or a folder.
    """
    try:
        # Without O_NONBLOCK the opening of a pipe waits for somebody who writes into it.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror})") from error
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise UsageError(f"{path}: is no regular file; give one")
    return os.fdopen(descriptor, "rb")


def tails(folders: Sequence[Path]) -> list[str]:
    """Return of each folder as little of the end of its path as tells all of them apart."""
    parts = [folder.resolve().parts for folder in folders]
    count = 1
    while count < max(map(len, parts), default=0) and len({one[-count:] for one in parts}) < len(set(parts)):
        count += 1
    return [str(Path(*one[-count:])) for one in parts]
