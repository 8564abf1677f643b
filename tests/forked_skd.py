"""`skd` in processes of their own, forked from one that has imported everything and has the kernels.

A start with all imports takes longer than most commands that tests run, and is the same each time. What a start itself
does belongs to tests that begin a Python: those of the version, of help, of an interrupt, of a cold cache.

The first process that needs it starts one server for all that run tests side by side. For each command the server forks
a keeper, which forks the command, waits for it and reports how it ended, or kills it when its test has gone. The
command gets arguments, folder, variables, search path and output as a new Python would have them, and leaves through
Python's own end.
"""

import atexit
import contextlib
import fcntl
import functools
import gc
import importlib
import json
import os
import pkgutil
import re
import select
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

_SIZE = struct.Struct("!Q")
TOKEN = "SKD_TEST_TOKEN"
"""Environment variable by which a test finds every process that came of it, children of children included."""
_FIXED = ("SKD_CACHE_DIR", "XDG_CACHE_HOME", "HOME")
"""Variables that have had their effect before a command is forked."""
_FIRST = (
    "--safe-count", "1", "--kamikaze-count", "1", "--collision-runs", "1", "--simulations", "5", "--workers", "1",
    "--quiet", "--overwrite",
)  # fmt: skip


class ForkedSkd:
    """A running command, as `subprocess.Popen` would be that captures its output as text."""

    def __init__(self, arguments: Sequence[str], *, cwd: Path, environment: Mapping[str, str]) -> None:
        assert [environment.get(name) for name in _FIXED] == [os.environ.get(name) for name in _FIXED]
        self._words = ["skd", *arguments]
        request = json.dumps({"arguments": [*arguments], "cwd": str(cwd), "environment": {**environment}}).encode()
        self._out, self._err = tempfile.TemporaryFile(), tempfile.TemporaryFile()  # noqa: SIM115
        self._keeper = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._keeper.connect(_server())
        socket.send_fds(self._keeper, [_SIZE.pack(len(request))], [self._out.fileno(), self._err.fileno()])
        self._keeper.sendall(request)
        self._answers = self._keeper.makefile("r")
        self.pid = int(self._answers.readline())

    def has_ended(self) -> bool:
        return bool(select.select([self._keeper], [], [], 0.0)[0])

    def finish(self, timeout: float) -> subprocess.CompletedProcess[str]:
        """Wait for its end; one that takes longer is killed, and TimeoutError raised."""
        self._keeper.settimeout(timeout)
        with self._keeper, self._answers, self._out, self._err:
            try:
                code = int(self._answers.readline())
            except TimeoutError:
                os.kill(self.pid, signal.SIGKILL)
                raise
            self._out.seek(0)
            self._err.seek(0)
            return subprocess.CompletedProcess(self._words, code, self._out.read().decode(), self._err.read().decode())


@functools.cache
def _server() -> str:
    """Return the address of the server, which is started unless another process of this run of tests has one."""
    side_by_side = os.environ.get("PYTEST_XDIST_TESTRUNUID")
    run = os.getppid() if side_by_side else os.getpid()  # not a worker: others need the server when that has ended
    folder = Path(tempfile.gettempdir(), f"skd-forks-{side_by_side or run}")
    folder.mkdir(mode=0o700, exist_ok=True)
    address = folder / "server"
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not address.exists():
            _start(address, run)
    return str(address)


def _start(address: Path, run: int) -> None:
    """Start a server, which ends with the process `run` and takes its folder along."""
    variables = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", TOKEN)}
    process = subprocess.Popen(
        [sys.executable, __file__, str(address), str(run)], env=variables, cwd=address.parent,
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
    )  # fmt: skip
    atexit.register(process.poll)  # keeps it: Python warns of a process that goes on when nothing refers to it
    assert process.stdout.readline() == b"ready\n", "the server of forked commands could not start"


def _serve(address: str, run: str) -> int:
    """Serve until the run of tests ends; in a process that became a command, return the command's exit code."""
    path = sys.path[1:]  # without this folder
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listener:
        importlib.import_module("shortened").shorten()
        _prepare(path)
        listener.bind(address)
        listener.listen()
        os.write(1, b"ready\n")
        while Path("/proc", run).exists():
            if not select.select([listener], [], [], 1.0)[0]:
                continue
            connection, _ = listener.accept()
            with connection:
                if os.fork() == 0:
                    listener.close()
                    return _keep(connection, path)
            with contextlib.suppress(ChildProcessError):
                while os.waitpid(-1, os.WNOHANG)[0]:
                    pass
    shutil.rmtree(Path(address).parent)
    return 0


def _prepare(path: Sequence[str]) -> None:
    """Have all that commands import, and the kernels; a campaign also brings what is imported or read late."""
    sys.path[:] = path
    main = importlib.import_module("skd_evaluator.cli.main").main
    package = importlib.import_module("skd_evaluator")
    for module in pkgutil.walk_packages(package.__path__, "skd_evaluator."):
        if not re.search(r"\.ros\b|__main__|pytest_plugin", module.name):  # ROS may not be there
            importlib.import_module(module.name)
    assert main(["assess", *_FIRST, "--out", "first"]) in (0, 1)
    # commands may have packages of their own
    importlib.import_module("skd_sim.options.registry")._installed.cache_clear()
    gc.freeze()  # or collecting would copy every page into each process


def _keep(connection: socket.socket, path: Sequence[str]) -> int:
    """Fork a command, and report its process and how it ended; in the fork, be the command."""
    size, descriptors, _, _ = socket.recv_fds(connection, _SIZE.size, 2)
    with connection.makefile("rb") as stream:
        request = json.loads(stream.read(*_SIZE.unpack(size)))
    child = os.fork()
    if child == 0:
        connection.close()
        return _become(request, descriptors, path)
    connection.sendall(b"%d\n" % child)
    if hasattr(os, "pidfd_open"):
        its_end = os.pidfd_open(child)
        if its_end not in select.select([its_end, connection], [], [])[0]:
            os.kill(child, signal.SIGKILL)  # nobody waits for it any more
    _, status = os.waitpid(child, 0)
    with contextlib.suppress(OSError):
        connection.sendall(b"%d\n" % os.waitstatus_to_exitcode(status))
    os._exit(0)


def _become(request: Mapping[str, Any], descriptors: Sequence[int], path: Sequence[str]) -> int:
    """Be `python -m skd_evaluator` with the arguments, and return its exit code."""
    nothing = os.open(os.devnull, os.O_RDONLY)
    for number, descriptor in enumerate((nothing, *descriptors)):
        os.dup2(descriptor, number)
        os.close(descriptor)
    os.chdir(request["cwd"])
    os.environ.clear()
    os.environ.update(request["environment"])
    added = os.environ.get("PYTHONPATH")
    sys.path[:] = [str(Path.cwd()), *(added.split(os.pathsep) if added else ()), *path]
    importlib.invalidate_caches()
    module = importlib.import_module("skd_evaluator")
    words = ["-m", "skd_evaluator", *request["arguments"]]
    sys.argv[:] = [str(Path(module.__path__[0], "__main__.py")), *request["arguments"]]
    sys.orig_argv[:] = [sys.executable, *words]
    return int(importlib.import_module("skd_evaluator.start").skd())


if __name__ == "__main__":
    sys.exit(_serve(*sys.argv[1:]))
