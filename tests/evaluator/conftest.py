"""A folder to run `skd` in, and `skd` in the tests' own process."""

from __future__ import annotations

import signal
import subprocess
from pathlib import Path

import pytest
from cli_support import CONTROLLERS, CROSSING
from skd_evaluator.cli.main import main


@pytest.fixture
def here(tmp_path: Path) -> Path:
    (tmp_path / "cars.py").write_text(CONTROLLERS)
    (tmp_path / "good.csv").write_text(CROSSING)
    return tmp_path


@pytest.fixture
def skd_here(here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """`skd` in this process, for cases of which one in a process of its own shows enough: Python's start takes long."""

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        monkeypatch.chdir(here)
        handler = signal.getsignal(signal.SIGTERM)
        try:
            code = main(list(arguments))
        except SystemExit as leave:
            code = int(leave.code or 0)
        finally:
            signal.signal(signal.SIGTERM, handler)
        return subprocess.CompletedProcess(arguments, code, *capsys.readouterr())

    return run
