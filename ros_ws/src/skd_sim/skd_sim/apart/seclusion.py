"""What a process gives up before it loads a user's code: the sight of other processes, and any hold on them.

Imports nothing that takes time or starts a thread: what is given up here is so for this thread, and for those that it
starts.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import platform
import struct
import sys
from collections.abc import Iterator
from pathlib import Path

from skd_sim.program.parent_death import end_with_parent

_LIBC = ctypes.CDLL(None, use_errno=True)
_CREATE, _ADD_RULE, _RESTRICT = 444, 445, 446  # system calls of landlock(7), by the same numbers everywhere
_VERSION = 1  # flag: only say which there is
_BENEATH = 1  # kind of a rule: whatever lies under a folder
_READ_FILE, _REFER = 1 << 2, 1 << 13  # to open a file for reading; to move one to another folder
_SIGNAL = 1 << 1  # scope: no signals to who is outside
_PR_SET_NO_NEW_PRIVS, _PR_SET_SECCOMP, _FILTER = 38, 22, 2
_PRLIMIT = {"x86_64": (0xC000003E, 302), "aarch64": (0xC00000B7, 261)}  # by machine: kind of its calls, prlimit(2)
_LOAD, _EQUALS, _AT_LEAST, _RETURN = 0x20, 0x15, 0x35, 0x06  # instructions of seccomp(2)
_NUMBER, _KIND, _FIRST = 0, 4, 16  # where a filter finds a call's number, its kind, and its first argument
_ALLOWED, _REFUSED = 0x7FFF0000, 0x00050001  # with EPERM
_OTHER_NUMBERS = 0x40000000  # from here on those of x86-64's other way to call


def seclude() -> bool:
    """Close what other processes say of themselves in /proc, and forbid to trace, signal or limit them; for good.

    Its own entry there stays open. Processes that this one starts are bound by the same, and see no entry of their own,
    either. All other files are as before. Tells whether it could be done: it takes Linux 5.19, and a container that
    does not forbid it; signals are forbidden from 6.12 on.
    """
    if not sys.platform.startswith("linux"):
        return False
    end_with_parent()
    _forbid_limits()
    version = _LIBC.syscall(_CREATE, None, ctypes.c_size_t(0), _VERSION)
    if version < 2:  # the first forbids to move files between folders, and cannot be told not to
        return False
    fields = (_READ_FILE | _REFER, 0, _SIGNAL) if version >= 6 else (_READ_FILE | _REFER,)
    attributes = struct.pack(f"={len(fields)}Q", *fields)
    rules = _LIBC.syscall(_CREATE, attributes, ctypes.c_size_t(len(attributes)), 0)
    if rules < 0:
        return False
    try:
        for path in _open_ones():
            _allow(rules, path)
        _LIBC.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
        return bool(_LIBC.syscall(_RESTRICT, rules, 0) == 0)
    finally:
        os.close(rules)


def _forbid_limits() -> None:
    """Forbid to set or read the limits of another process (prlimit(2)), for good, where that can be done.

    Limits of its own stay its own, by process 0 or by its number. Where a process of the same user may have
    its limits taken, it fails in ways that name nobody, and keeps what another one has counted in them.
    """
    kind, number = _PRLIMIT.get(platform.machine(), (0, 0))
    if not kind:
        return
    steps = (
        (_LOAD, 0, 0, _KIND),
        (_EQUALS, 0, 7, kind),  # else refused: a call of 32 bits
        (_LOAD, 0, 0, _NUMBER),
        (_AT_LEAST, 5, 0, _OTHER_NUMBERS),
        (_EQUALS, 0, 3, number),
        (_LOAD, 0, 0, _FIRST),
        (_EQUALS, 1, 0, 0),
        (_EQUALS, 0, 1, os.getpid()),
        (_RETURN, 0, 0, _ALLOWED),
        (_RETURN, 0, 0, _REFUSED),
    )
    program = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *step) for step in steps))
    _LIBC.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    told = struct.pack("@HP", len(steps), ctypes.addressof(program))
    _LIBC.prctl(_PR_SET_SECCOMP, _FILTER, told, 0, 0)


def _open_ones() -> Iterator[Path]:
    """Yield all that lies in the root, but in /proc only what is of no process, or of this one."""
    processes = Path("/proc")
    yield from (path for path in Path("/").iterdir() if path != processes)
    with contextlib.suppress(OSError):
        yield from (path for path in processes.iterdir() if not path.name.isdecimal())


def _allow(rules: int, path: Path) -> None:
    with contextlib.suppress(OSError):  # what nobody may open is allowed nobody
        place = os.open(path, os.O_PATH | os.O_CLOEXEC)
        try:
            access = _READ_FILE | _REFER if path.is_dir() else _READ_FILE
            rule = struct.pack("=Qi", access, place)
            _LIBC.syscall(_ADD_RULE, rules, _BENEATH, rule, 0)
        finally:
            os.close(place)
