"""Temporary folders beside the results: named for the process that made them, so that those of the dead can go."""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import socket
import tempfile
import zlib
from contextlib import suppress
from pathlib import Path

PREFIX = ".skd-"
_EXCHANGE, _HERE = 1 << 1, -100
"""Of renameat2(2): RENAME_EXCHANGE, and AT_FDCWD."""
_NAME = re.compile(r"\.skd-([0-9a-f]{8})-([0-9]{1,10})-([0-9]{1,20})-[^.]+")


def make_temporary(parent: Path) -> Path:
    """Make a temporary folder of this process; first remove those that runs on this machine left when they died.

    Raises:
        OSError: it cannot be made.
    """
    remove_stale(parent)
    pid = os.getpid()
    return Path(tempfile.mkdtemp(prefix=f"{PREFIX}{_machine()}-{pid}-{_started(pid)}-", dir=parent))


def remove_stale(parent: Path) -> None:
    """Remove temporary folders whose process has died; what cannot be told, or removed, stays.

    Results that were just being replaced (.old) stay as well: they may be the only copy.
    """
    if not Path("/proc/self/stat").exists():
        return
    with suppress(OSError):
        for folder in parent.iterdir():
            found = _NAME.fullmatch(folder.name)
            if found and found[1] == _machine() and not folder.is_symlink() and found[3] != _started(int(found[2])):
                shutil.rmtree(folder, ignore_errors=True)


def remove(folder: Path) -> None:
    """Remove a folder, wholly also where an interrupt comes meanwhile; what cannot be removed stays."""
    try:
        shutil.rmtree(folder, ignore_errors=True)
    except KeyboardInterrupt:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def exchange(one: Path, other: Path) -> bool:
    """Exchange two folders at once, so that whoever is killed meanwhile leaves both; tell whether that could be done.

    It takes Linux and a file system that can do so (renameat2(2)).
    """
    library = ctypes.CDLL(None, use_errno=True)
    if not hasattr(library, "renameat2"):
        return False
    return bool(library.renameat2(_HERE, os.fsencode(one), _HERE, os.fsencode(other), _EXCHANGE) == 0)


def _machine() -> str:
    """Return a short name for where process ids mean the same: a machine, or a container on it."""
    try:
        processes = Path("/proc/self/ns/pid").stat().st_ino
    except OSError:
        processes = 0
    return f"{zlib.crc32(f'{socket.gethostname()} {processes}'.encode()):08x}"


def _started(pid: int) -> str:
    """Return when a process started, in ticks since the machine did; 0 where there is none such (Linux)."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()
    except OSError:
        return "0"
    return "0" if fields[0] in (b"Z", b"X") else fields[19].decode()
