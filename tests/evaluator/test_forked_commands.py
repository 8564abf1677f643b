"""What tests run in place of a new Python does what that does."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import pytest
from cli_support import skd, skd_from_nothing, started
from common import PATIENCE, wait_until

SAYS = """
import atexit, os, sys

class Car:
    def __init__(self):
        print("argv", sys.argv, "first", sys.path[0], "there", os.environ["THERE"], "at", os.getcwd())
        print("aside", file=sys.stderr)
        atexit.register(print, "the end")
        raise ValueError("no car today")
"""


@pytest.mark.parametrize("words", [("--version",), ("assess", "--wings"), ("assess", "--controller", "says:Car")])
def test_a_forked_command_is_as_one_from_nothing(here: Path, words: tuple[str, ...]) -> None:
    (here / "says.py").write_text(SAYS)
    one, other = (run(*words, cwd=here, THERE="yes") for run in (skd, skd_from_nothing))
    assert (one.returncode, one.stdout, one.stderr) == (other.returncode, other.stdout, other.stderr)


def test_it_ends_by_the_signal_that_kills_it(here: Path) -> None:
    process = started("assess", "--kamikaze-count", "100000", cwd=here)
    assert not process.has_ended()
    os.kill(process.pid, signal.SIGKILL)
    assert process.finish(PATIENCE).returncode == -signal.SIGKILL


@pytest.mark.skipif(sys.platform != "linux", reason="a keeper hears of both ends on Linux only")
def test_one_that_nobody_waits_for_any_more_is_killed(here: Path) -> None:
    process = started("assess", "--kamikaze-count", "100000", cwd=here)
    pid = process.pid
    del process
    wait_until(lambda: not Path(f"/proc/{pid}").exists(), f"the end of {pid}")
