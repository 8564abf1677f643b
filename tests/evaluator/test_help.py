"""What `skd` says of itself, wherever it is written to, and from wherever it is started."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from cli_support import one_line, skd_from_nothing
from common import run_skd


def test_version_and_help(here):
    done = skd_from_nothing("--version", cwd=here)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("skd ")
    listing = skd_from_nothing("--help", cwd=here).stdout
    for command in ("assess", "sweep"):
        assert command in listing
        done = skd_from_nothing(command, "--help", cwd=here)
        assert (done.returncode, done.stderr) == (0, "")
        assert "--out" in done.stdout


@pytest.mark.parametrize("words", [["--version"], ["assess", "--help"]])
def test_help_that_cannot_be_written_is_an_error_in_a_line(here, words):
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "skd_evaluator", *words], cwd=here, stdout=full, stderr=subprocess.PIPE, text=True
        )
    one_line(done, 1, "skd: error", "No space left on device")


def test_help_is_written_on_a_terminal_that_knows_no_greek(here):
    greek, plain = (
        skd_from_nothing("assess", "--help", cwd=here, PYTHONIOENCODING=encoding) for encoding in ("utf-8", "ascii")
    )
    assert "φ" in greek.stdout
    assert (plain.returncode, plain.stderr) == (0, "")
    assert plain.stdout == greek.stdout.encode("ascii", "replace").decode()


def test_a_current_folder_that_is_gone_is_said(here, tmp_path):
    gone = tmp_path / "gone"
    gone.mkdir()
    script = f"cd {gone} && rmdir {gone} && exec {sys.executable} -m skd_evaluator compare {here} {here}"
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True)
    one_line(done, 1, "the current folder was removed")


def test_every_command_explains_itself(capsys):
    assert run_skd("--help") == 0
    commands = re.findall(r"^    (\w+) ", capsys.readouterr().out, re.MULTILINE)
    assert {"assess", "episode", "probe"} <= set(commands)
    for command in commands:
        assert run_skd(command, "--help") == 0, command
        assert f"usage: skd {command}" in capsys.readouterr().out
