"""What tests of several folders share: patience, DDS domains of their own, and `skd` in the tests' own process."""

import ast
import contextlib
import io
import os
import random
import signal
import socket
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from forked_skd import TOKEN
from skd_sim.errors import UsageError

PATIENCE = 300.0
"""s to wait for what must happen: a test that passes never waits so long, however busy the machine is."""

_reserved: deque[socket.socket] = deque()
_KEPT = 25  # as many as one test uses at once; older ones are free again, or a long run would use all of them up
_PORTS = 250  # of one domain; a process numbers its participants across all domains, so that each may be held


def new_domain() -> int:
    """A DDS domain that no other test and no graph of `skd` uses, in this process or beside it, and in which nobody is.

    It is reserved by the name by which `skd` reserves those that it chooses by itself.
    """
    reason: OSError | None = None
    for domain in random.SystemRandom().sample(range(1, 102), 101):
        guard = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            guard.bind(f"\0skd-ros-domain-{domain}")
            for port in range(7400 + _PORTS * domain, 7400 + _PORTS * (domain + 1)):
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                    probe.bind(("0.0.0.0", port))
        except OSError as error:
            guard.close()
            reason = error
            continue
        _reserved.append(guard)
        if len(_reserved) > _KEPT:
            _reserved.popleft().close()
        return domain
    raise RuntimeError(f"every domain is in use ({reason})")


def wait_until(condition: Callable[[], Any], what: str = "what has to be", timeout: float = PATIENCE) -> Any:
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        found = condition()
        if found:
            return found
        time.sleep(0.03)
    raise AssertionError(f"waited {timeout:g} s in vain for {what}")


def is_alive(process: object) -> bool:
    """Whether a process is there, and not but waiting to be asked how it ended."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] not in ("Z", "X")
    except OSError:
        return False


def pids_with(token: str) -> dict[int, str]:
    """Command lines, by pid, of the living processes whose environment holds a token."""
    wanted = f"{TOKEN}={token}".encode()
    found = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal() and int(entry.name) != os.getpid():
            with contextlib.suppress(OSError):
                if wanted in (entry / "environ").read_bytes().split(b"\0"):
                    found[int(entry.name)] = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
    return found


def wait_for_line(process: subprocess.Popen[str], wanted: str) -> str:
    """Return the first line of a program's standard output that holds a text.

    It is empty where the program ends without one; a program that says nothing for too long is killed.
    """
    killer = threading.Timer(PATIENCE, process.kill)
    killer.start()
    try:
        return next((line for line in iter(process.stdout.readline, "") if wanted in line), "")
    finally:
        killer.cancel()


@cache
def imported(module: Path) -> set[str]:
    """The top-level packages that a module imports, wherever in it."""
    found = set()
    for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {name.name.split(".")[0] for name in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            found.add(node.module.split(".")[0])
    return found


def run_program(*words: object, cwd: Path | None = None, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run a program to its end, with further variables, and return how it ended and what it said."""
    return subprocess.run(
        [*map(str, words)], cwd=cwd, env=os.environ | variables, capture_output=True, text=True, timeout=PATIENCE
    )


@contextlib.contextmanager
def refused(*parts: object, error: type[Exception] = UsageError) -> Iterator[pytest.ExceptionInfo[Exception]]:
    """What is done within is refused in one line, which holds all of these parts."""
    with pytest.raises(error) as caught:
        yield caught
    said = str(caught.value)
    assert ("\n" in said, [part for part in parts if str(part) not in said]) == (False, []), said


def assert_valid(assessment: Any) -> None:
    """Hold the content of an assessment.json against its schema."""
    from skd_evaluator.assessment.files.assessment_json import assessment_schema

    schema = assessment_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    found = jsonschema.Draft202012Validator(schema).iter_errors(assessment)
    assert [f"{list(one.path)}: {one.message:.200}" for one in found] == []


def run_skd(*arguments: object) -> int:
    """Run `skd` in this process, and return its exit code; for cases that need no process of their own."""
    from skd_evaluator.cli.main import main

    handler = signal.getsignal(signal.SIGTERM)
    try:
        return main([str(argument) for argument in arguments])
    except SystemExit as leave:
        return int(leave.code or 0)
    finally:
        signal.signal(signal.SIGTERM, handler)


def assert_same_episodes(one: bytes, other: bytes) -> None:
    """Two episodes.npz are the same byte for byte, but for what the adversary believed: only in process is it known."""
    if one == other:
        return
    with np.load(io.BytesIO(one)) as here, np.load(io.BytesIO(other)) as there:
        differ = {
            name for name in set(here) ^ set(there) if not name.startswith(("margin", "risk"))
        }  # the car is needed
        assert differ <= {"belief"}
        for name in set(here) & set(there):
            assert (here[name].dtype, here[name].shape) == (there[name].dtype, there[name].shape), name
            assert here[name].tobytes() == there[name].tobytes(), name
