"""What the system denies: standard streams that are closed, and descriptors of which there are too few."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from cli_support import CROSSING, SMALL
from common import PATIENCE

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
        here, "--adversary-model", "generic", "--controller", "noisy:Car", "--no-pictures", "--out", "out", first=first
    )
    assert done.returncode == 0
    assert "Traceback" not in done.stdout
    return (here / "out" / "episodes.npz").read_bytes()


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    here = tmp_path_factory.mktemp("results")
    (here / "good.csv").write_text(CROSSING)
    assert run(here, "--no-pictures", "--margin-limit", "0", "--out", "first", first=lambda: None).returncode == 0
    shutil.copytree(here / "first", here / "second")
    return here


def test_what_nobody_reads_is_written(results: Path) -> None:
    """The tables are printed before anything is written, as pictures take longer."""
    reading, writing = os.pipe()
    os.close(reading)
    words = [sys.executable, "-m", "skd_evaluator", "compare", "first", "second", "--no-pictures", "--out", "c"]
    done = subprocess.run(words, cwd=results, stdout=writing, stderr=subprocess.PIPE, timeout=PATIENCE, check=False)
    os.close(writing)
    assert (done.returncode, b"Traceback" in done.stderr) == (1, False)
    assert (results / "c" / "manifest.sha256").exists()
