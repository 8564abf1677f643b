"""Only a test that starts processes may fail once, and only one in a run: what is run again hides races."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from common import PATIENCE

HERE = Path(__file__).resolve().parent
TESTS = """
from pathlib import Path
import subprocess, sys
import pytest

def fails_once(name):
    marker = Path(__file__).parent / name
    before = marker.exists()
    marker.touch()
    assert before, f"{name} for the first time"

def program():
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        return process.wait()

class Holder:
    def __init__(self):
        program()

@pytest.fixture
def held():
    return Holder()

def test_one_without_a_process(): fails_once("none")
def test_one_of_a_process(): fails_once(f"first-{program()}")
def test_another_by_its_fixture(held): fails_once("second")
"""


@pytest.mark.parametrize("workers", [[], ["-n", "2", "--dist", "loadfile"]])
def test_one_test_of_living_processes_is_run_again(tmp_path: Path, workers: list[str]) -> None:
    (tmp_path / "tests" / "graph").mkdir(parents=True)
    for name in ("conftest.py", "undrawn.py"):
        shutil.copy(HERE / name, tmp_path / "tests")
    shutil.copy(HERE.parent / "pyproject.toml", tmp_path)
    (tmp_path / "tests" / "graph" / "test_some.py").write_text(TESTS)
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *workers, "tests"]
    ros = [option for name in ("launch_testing", "launch_ros", "launch_pytest") for option in ("-p", f"no:{name}")]
    done = subprocess.run([*command, *ros], cwd=tmp_path, capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 1, done.stdout
    assert re.search(r"2 failed, 1 passed, 1 rerun", done.stdout), done.stdout
    assert len(re.findall(r"^RERUN ", done.stdout, re.MULTILINE)) == 1
    assert "none for the first time" in done.stdout
    assert "first-0 for the first time" in done.stdout  # its traceback, although it passed then
    assert re.search(r"FAILED .*test_one_without_a_process", done.stdout)
