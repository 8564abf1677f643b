"""What the system denies: standard streams that are closed, and descriptors of which there are too few."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from cli_support import CROSSING, SMALL
from common import PATIENCE
from skd_evaluator.cli.commands.overview import list as list_command
from skd_evaluator.cli.main import main

NOISY = """
class Car:
    def reset(self, scenario, rng): print("reset", flush=True)
    def command(self, car, adversary): return 0.0
"""


def run(here: Path, *words: str, first: Callable[[], object]) -> subprocess.CompletedProcess[str]:
    """Run a command in a process in which something is called first; no stream of its is a pipe that `first` closes."""
    command = [sys.executable, "-m", "skd_evaluator", "assess", *SMALL, "--safe", "good.csv", *words]
    variables = {**os.environ, "PYTHONPATH": str(here)}
    with (here / "said").open("w") as said:
        done = subprocess.run(
            command, cwd=here, stdin=subprocess.DEVNULL, stdout=said, stderr=said, env=variables,
            preexec_fn=first, timeout=PATIENCE, check=False,
        )  # fmt: skip
    return subprocess.CompletedProcess(command, done.returncode, (here / "said").read_text())


def noisy(here: Path, first: Callable[[], object]) -> bytes:
    """Assess a car that prints, in a process in which something is called first; return the episodes."""
    (here / "noisy.py").write_text(NOISY)
    (here / "good.csv").write_text(CROSSING)
    done = run(
        here, "--knowledge", "nothing", "--controller", "noisy:Car", "--no-pictures", "--out", "out", first=first
    )
    assert done.returncode == 0
    assert "Traceback" not in done.stdout
    return (here / "out" / "episodes.npz").read_bytes()


@pytest.fixture(scope="module")
def with_streams(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return noisy(tmp_path_factory.mktemp("streams"), first=lambda: None)


@pytest.mark.parametrize("closed", [(1,), (2,), (0, 1, 2)])
def test_closed_streams_lead_nowhere(tmp_path: Path, with_streams: bytes, closed: tuple[int, ...]) -> None:
    """What is printed must not come into a file that has got the number of a closed stream."""
    assert noisy(tmp_path, first=lambda: [os.close(one) for one in closed]) == with_streams


@pytest.mark.parametrize("count", [11, 14])
def test_too_few_descriptors_are_said_in_a_line(here: Path, count: int) -> None:
    done = run(
        here, "--workers", "2", "--out", "out",
        first=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (count, count)),
    )  # fmt: skip
    assert done.returncode == 1
    (line,) = done.stdout.splitlines()
    assert line.startswith("skd assess: error: [Errno 24] Too many open files")
    assert line.endswith("; allow more (ulimit -n)")
    assert not (here / "out").exists()


def test_too_little_memory_is_said_in_a_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As under ulimit -v: there was a traceback."""

    def fails(_arguments: object) -> int:
        np.empty(2**46)
        raise AssertionError

    monkeypatch.setattr(list_command, "run", fails)
    assert main(["list", "."]) == 1
    assert capsys.readouterr().err.splitlines() == ["skd list: error: out of memory (limit: ulimit -v)"]


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    here = tmp_path_factory.mktemp("results")
    (here / "good.csv").write_text(CROSSING)
    assert run(here, "--no-pictures", "--margin-limit", "0", "--out", "first", first=lambda: None).returncode == 0
    shutil.copytree(here / "first", here / "second")
    return here


@pytest.mark.parametrize("command", ["compare", "trend"])
def test_what_nobody_reads_is_written(results: Path, command: str) -> None:
    """These print their tables before they write, as pictures take longer."""
    reading, writing = os.pipe()
    os.close(reading)
    words = [sys.executable, "-m", "skd_evaluator", command, "first", "second", "--no-pictures", "--out", command]
    done = subprocess.run(words, cwd=results, stdout=writing, stderr=subprocess.PIPE, timeout=PATIENCE, check=False)
    os.close(writing)
    assert (done.returncode, b"Traceback" in done.stderr) == (1, False)
    assert (results / command / "manifest.sha256").exists()
