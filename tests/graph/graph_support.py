"""What the tests of the graph share: domains, processes that leave nothing behind, the command line."""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from common import PATIENCE, assert_same_episodes, new_domain, pids_with, run_skd, wait_until
from forked_skd import TOKEN, ForkedSkd
from skd_evaluator.assessment.options import GraphOptions
from skd_evaluator.report.progress import COMPILING
from skd_evaluator.ros.processes import GraphSetting
from skd_evaluator.ros.session import graph_session
from skd_sim.options.car_and_adversary import CarUnderTest
from skd_sim.world.episode import EpisodeLog

HERE = Path(__file__).resolve().parent
CAMPAIGN = ("--safe-count", 2, "--kamikaze-count", 3, "--collision-runs", 4, "--seed", 5, "-p", "risk_runs:=20")
MULTIPLIERS = (0.5, 1.0)


@dataclass(frozen=True)
class Campaign:
    """Results of one campaign run both ways."""

    graph: Path
    in_process: Path

    @property
    def bags(self) -> Path:
        return self.graph / "bags"


def of_node(token: str, name: str) -> int:
    return wait_until(lambda: next((pid for pid, line in pids_with(token).items() if name in line), 0), name)


def assert_all_gone(token: str, timeout: float = 60.0) -> None:
    """No process with the token is left; what is left is killed, and named."""
    end = time.monotonic() + timeout
    while (left := pids_with(token)) and time.monotonic() < end:
        time.sleep(0.02)
    for pid in left:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    assert not left, f"left behind: {left}"


_OF_A_BUSY_MACHINE = re.compile(
    r"skd: (waiting for \S+ \(\d+ s\): |\w+ did not end within |step \d+ of \d+: |[^:]+ \(\d+\)$|[^:]+, \d+ of \d+, |"
    + re.escape(COMPILING)  # the last four after five seconds
    + ")"
)


@dataclass
class Finished:
    code: int
    out: str
    err: str

    @property
    def lines(self) -> list[str]:
        """Of standard error."""
        return self.err.strip().splitlines()

    @property
    def timeless(self) -> list[str]:
        """Lines of standard error but those that a busy or new machine adds: nodes that come or end late, progress."""
        return [line for line in self.lines if not _OF_A_BUSY_MACHINE.match(line)]


def _variables(token: str, environment: Mapping[str, str | None] | None) -> dict[str, str]:
    """Return the variables of a command: some of its own, of which one whose value is None is taken away."""
    base = {
        key: value
        for key, value in os.environ.items()
        if key in ("SKD_CACHE_DIR", "ROS_DISTRO") or not key.startswith(("ROS_", "SKD_"))
    }  # every process compiles to the same place, or a test would wait for all kernels once more
    base |= {"ROS_DOMAIN_ID": str(new_domain()), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    chosen = {**base, TOKEN: token, **(environment or {})}
    return {name: value for name, value in chosen.items() if value is not None}


class Program:
    """A running command with a token and, unless given one, a domain of its own."""

    def __init__(self, command: Sequence[str], environment: Mapping[str, str | None] | None = None) -> None:
        """Start it with variables of its own; one whose value is None is taken away."""
        self.token = uuid.uuid4().hex
        variables = {"PYTHONFAULTHANDLER": "1"} | _variables(self.token, environment)
        how = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        self.popen = subprocess.Popen(command, env=variables, start_new_session=True, **how)

    def finish(self, timeout: float = PATIENCE) -> Finished:
        """Wait for its end, and see that nothing is left of it; one that does not end says where it is."""
        try:
            out, err = self.popen.communicate(timeout=timeout)
        except subprocess.TimeoutExpired:
            self.popen.send_signal(signal.SIGABRT)  # with which Python's fault handler prints every thread's calls
            out, err = self.popen.communicate()
            assert_all_gone(self.token, 0.0)
            raise AssertionError(f"did not end within {timeout:g} s; it said:\n{out}\n{err}") from None
        assert_all_gone(self.token)
        return Finished(self.popen.returncode, out, err)


def skd_command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "skd_evaluator", *map(str, arguments)]


class Skd:
    """A running `skd` with a token and a domain of its own, in a process forked from one that has imported it."""

    def __init__(self, *arguments: object, environment: Mapping[str, str | None] | None = None) -> None:
        """Start it with variables of its own, as a program."""
        self._token = uuid.uuid4().hex
        words, variables = [str(word) for word in arguments], _variables(self._token, environment)
        self._process = ForkedSkd(words, cwd=Path.cwd(), environment=variables)

    def send_signal(self, number: int) -> None:
        os.kill(self._process.pid, number)

    def has_ended(self) -> bool:
        return self._process.has_ended()

    def finish(self, timeout: float = PATIENCE) -> Finished:
        """Wait for its end, and see that nothing is left of it."""
        try:
            done = self._process.finish(timeout)
        finally:
            assert_all_gone(self._token)
        return Finished(done.returncode, done.stdout, done.stderr)


def skd(*arguments: object, environment: Mapping[str, str | None] | None = None, timeout: float = PATIENCE) -> Finished:
    return Skd(*arguments, environment=environment).finish(timeout)


def skd_here(capsys: pytest.CaptureFixture[str], *arguments: object) -> Finished:
    """Run `skd` in this process; for commands that start no graph."""
    capsys.readouterr()
    return Finished(run_skd(*arguments), *capsys.readouterr())


_WITH_THE_CAR = {
    "margin": "margin|optimality_gap|impact_speed|equivalent_multiplier|vulnerability_curve",
    "risk_1": "risk",
    "time_lost": "time_lost|deadlock|needless|slow|price",
}
"""Figures that take the car, and not its recordings alone, by one of them that is missing where they are."""


def numbers(folder: Path) -> dict[str, Any]:
    """assessment.json without what says how it was made rather than what came out."""
    content: dict[str, Any] = json.loads((folder / "assessment.json").read_text())
    no_result = ("seconds", "command_age", "safe", "provenance", "warnings")
    return {key: value for key, value in content.items() if key not in no_result}


def assert_same_results(one: Path, other: Path) -> None:
    """Two assessments are the same to the last bit: every number, and every trajectory.

    See `assert_same_episodes` for what only one of them knows. What takes the car may be missing in one.
    """
    ours, theirs = numbers(one), numbers(other)
    for figure, names in _WITH_THE_CAR.items():
        if None in (ours[figure], theirs[figure]):
            ours, theirs = ({key: one[key] for key in one if not re.match(names, key)} for one in (ours, theirs))
    assert ours == theirs
    assert_same_episodes(*((folder / "episodes.npz").read_bytes() for folder in (one, other)))


def assert_same_log(one: EpisodeLog, other: EpisodeLog) -> None:
    assert one.outcome == other.outcome, (one.reason, other.reason)
    for name in ("adversary", "car"):
        left, right = getattr(one, name), getattr(other, name)
        assert left.shape == right.shape
        assert left.dtype == right.dtype
        assert left.tobytes() == right.tobytes(), name
    for name in ("impact_time", "impact_speed"):
        assert np.float64(getattr(one, name)).tobytes() == np.float64(getattr(other, name)).tobytes(), name
    assert one.clipped == other.clipped


@contextlib.contextmanager
def in_domain(domain: int, token: str) -> Iterator[None]:
    """This process's environment, for graphs that it starts itself."""
    kept = dict(os.environ)
    os.environ.update({"ROS_DOMAIN_ID": str(domain), TOKEN: token})
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(kept)


@contextlib.contextmanager
def whole_graph(
    folder: Path,
    options: GraphOptions | None = None,
    *,
    controller: str = "",
    record_to: Path | None = None,
    domain: int | None = None,
) -> Iterator[tuple[Any, str]]:
    """Run a graph that this process evaluates, by default with the basic car; nothing is left of it."""
    options = options or GraphOptions()
    controller = controller or ("external" if options.controller_command else "basic")
    from skd_evaluator.ros.graph import free_domain

    token, domain = uuid.uuid4().hex, domain or free_domain()  # that of a graph which has ended here, if any
    with (
        in_domain(domain, token),
        graph_session(
            GraphSetting(options=options, car=CarUnderTest(controller), log_folder=folder, record_to=record_to)
        ) as evaluator,
    ):
        yield evaluator, token
    assert_all_gone(token)
