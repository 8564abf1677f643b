"""What `skd` says of itself, wherever it is written to, and from wherever it is started."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from cli_support import one_line
from common import run_skd


@pytest.mark.parametrize("words", [["--version"], ["assess", "--help"]])
def test_help_that_cannot_be_written_is_an_error_in_a_line(here, words):
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "skd_evaluator", *words], cwd=here, stdout=full, stderr=subprocess.PIPE, text=True
        )
    one_line(done, 1, "skd: error", "No space left on device")


def test_every_command_explains_itself(capsys):
    assert run_skd("--help") == 0
    commands = re.findall(r"^  (\w+) ", capsys.readouterr().out, re.MULTILINE)
    assert {"assess", "episode", "probe"} <= set(commands)
    for command in commands:
        assert run_skd(command, "--help") == 0, command
        assert f"usage: skd {command}" in capsys.readouterr().out
