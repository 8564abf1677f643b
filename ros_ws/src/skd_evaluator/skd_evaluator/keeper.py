"""A keeper above a process that runs other people's code: it ends all that this process has started, come what may.

`keep` divides a process that was just forked into two. The child goes on; its parent turns into the keeper, a small
program that does nothing but wait. The keeper is a subreaper (`prctl(2)`, PR_SET_CHILD_SUBREAPER): whatever descends
from the child, in sessions of its own, by a double fork, with an empty environment, stays a descendant of the keeper
when its parent ends. When the child has ended, the keeper kills all that is left below it and ends as the child did.
It does so at once when it is told to, and when the process that owns it is gone, by whatever death.

Whoever kills the keeper itself kills the child (PR_SET_PDEATHSIG), but not what that has started.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
from pathlib import Path

END_ALL = signal.SIGHUP
"""Tells a keeper to kill all that is below it at once."""
_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36
_LIBC = ctypes.CDLL(None)  # loaded here: a forked child of a process with threads must not load anything
_HEARD = (signal.SIGHUP, signal.SIGCHLD)
_DEAF = (signal.SIGINT, signal.SIGTERM, signal.SIGTSTP, signal.SIGQUIT)

_KEEPER = """
import os, resource, signal, sys, time
child, owner, patience = int(sys.argv[1]), int(sys.argv[2]), 2.0
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # the child's is enough, should both end by the same signal
heard = {signal.SIGHUP, signal.SIGCHLD, signal.SIGINT, signal.SIGTERM, signal.SIGTSTP, signal.SIGQUIT}
ended = []  # how the child has ended, once it has

def bury():
    while True:
        try:
            pid, how = os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return False  # nobody is left: descendants without a parent are children of this process
        if pid == 0:
            return True
        if pid == child:
            ended.append(how)

def below():
    parents = {}
    for entry in filter(str.isdecimal, os.listdir("/proc")):
        try:
            with open("/proc/" + entry + "/stat", "rb") as file:
                fields = file.read().rpartition(b")")[2].split()
            parents[int(entry)] = int(fields[1])
        except (OSError, IndexError, ValueError):
            pass
    found = {os.getpid()}
    while more := {pid for pid, parent in parents.items() if parent in found} - found:
        found |= more
    return found - {os.getpid()}

def end_all():
    begin = time.monotonic()
    while bury() and time.monotonic() - begin < patience:
        for number in (signal.SIGSTOP, signal.SIGKILL):  # what stands still starts nothing
            for pid in below():
                try:
                    os.kill(pid, number)
                except OSError:
                    pass
        signal.sigtimedwait({signal.SIGCHLD}, 0.02)

while bury() and not ended and os.getppid() == owner:
    came = signal.sigtimedwait(heard, 0.5)
    if came is not None and came.si_signo == signal.SIGHUP:
        break
end_all()
if ended:
    code = os.waitstatus_to_exitcode(ended[0])
else:
    code = -signal.SIGKILL
if code >= 0:
    os._exit(code)
try:
    signal.signal(-code, signal.SIG_DFL)
except (OSError, ValueError):
    pass
signal.pthread_sigmask(signal.SIG_UNBLOCK, {-code})
os.kill(os.getpid(), -code)
os._exit(1)
"""


def can_keep() -> bool:
    """Whether there can be a keeper here: it takes Linux, and a Python to begin."""
    return sys.platform.startswith("linux") and bool(sys.executable)


def keep() -> int:
    """Become two processes, in one that was just forked; return, in the child, the id of the keeper above it.

    The parent's own end is that of the keeper; it never returns. Where there can be no keeper, this process itself goes
    on, and the id is that of its parent.

    Raises:
        OSError: there is no process left.
    """
    owner = os.getppid()
    if not can_keep():
        return owner
    keeper = os.getpid()
    variables = {name: os.environ[name] for name in ("LD_LIBRARY_PATH",) if name in os.environ}
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # where it was ignored, nobody would learn how a child ended
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (*_HEARD, *_DEAF))
    _LIBC.prctl(_PR_SET_CHILD_SUBREAPER, 1)
    child = os.fork()
    if child == 0:
        _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != keeper:
            os._exit(1)  # the keeper was killed before it could be one
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        return keeper
    try:
        # A program of its own: it holds neither memory nor files of the process that was forked.
        os.execve(sys.executable, [sys.executable, "-I", "-S", "-c", _KEEPER, str(child), str(owner)], variables)
    finally:
        os.kill(child, signal.SIGKILL)
        os._exit(1)


def end_now(keeper: int) -> None:
    """Have a keeper kill all that is below it, and end; one that is stopped, too."""
    for number in (END_ALL, signal.SIGCONT):
        with contextlib.suppress(OSError):
            os.kill(keeper, number)


def is_stopped(pid: int) -> bool:
    """Whether a process is stopped by a signal, as by SIGSTOP; one under a debugger is not."""
    return _state(pid) == b"T"


def has_ended(pid: int) -> bool:
    """Whether a process has ended, waited for by its parent or not; of id 0, which nobody has, it is not known."""
    return pid > 0 and _state(pid) in (b"Z", b"X", b"")


def _state(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[0]
    except OSError:
        return b""
