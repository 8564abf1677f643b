"""What the terminal says of a campaign that came to nothing: who is to blame, and where more of it stands."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path

import pytest
from common import PATIENCE
from graph_support import HERE, Finished, skd, skd_here


def assess(folder: Path, safe: Path, *options: object, timeout: float = PATIENCE) -> Finished:
    """Run a small campaign through the graph."""
    return skd(
        *("assess", "--graph", "--safe", safe, "--safe-count", 1, "--kamikaze-count", 2, "--collision-runs", 2),
        *("--simulations", 100, "--startup-timeout", timeout, "--command-timeout", timeout, *options),
        *("--out", folder / "out"),
        environment={"PYTHONPATH": str(HERE / "controllers")},
    )


def hostile(kind: str) -> tuple[str, ...]:
    """Options for a controller that does what none should."""
    return (
        "--controller",
        "external",
        "--controller-command",
        shlex.join([sys.executable, f"{HERE}/hostile_nodes.py", kind]),
    )


@pytest.mark.parametrize("command", ["", "  "])
def test_an_empty_command(capsys: pytest.CaptureFixture[str], tmp_path: Path, command: str) -> None:
    finished = skd_here(
        capsys,
        "assess",
        "--graph",
        "--controller",
        "external",
        "--controller-command",
        command,
        "--out",
        tmp_path / "o",
    )
    assert finished.code == 2
    (line,) = finished.lines
    assert "--controller-command: is empty" in line


def test_nobody_drives(tmp_path: Path, safe: Path) -> None:
    """It says what it waits for, once, and does not wait for hours."""
    finished = assess(tmp_path, safe, "--controller", "external", timeout=2.0)
    assert finished.code == 1
    assert finished.lines[0].startswith("skd: waiting for a publisher of /ego/acceleration_command (ROS_DOMAIN_ID=")
    (last,) = finished.lines[1:]
    assert "3 starts in a row failed, the last one so: not started: the car controller" in last
    assert "nobody publishes on /ego/acceleration_command; log: " in last
    assert Path(last.rpartition("log: ")[2]).exists()
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("nan", "not a finite number: the car controller commanded nan"),
        ("stamps", "wrong stamp: the car controller"),
        ("elsewhere", "but somebody does so on /brake"),
    ],
)
def test_one_that_never_begins(tmp_path: Path, safe: Path, kind: str, said: str) -> None:
    finished = assess(tmp_path, safe, *hostile(kind), timeout=5.0)
    assert finished.code == 1
    (line,) = finished.lines
    assert "3 starts in a row failed" in line
    assert said in line
    assert line.endswith("car_controller.log")


def test_all_aborted(tmp_path: Path, safe: Path) -> None:
    finished = assess(tmp_path, safe, "--controller", "misbehaving:NeverWell")
    assert finished.code == 1
    undefined, aborted, log = finished.lines
    reason = "not a finite number: the car controller commanded nan"
    assert undefined == f"skd assess: every kamikaze episode was aborted ({reason}); SKD is not defined"
    assert aborted.endswith(f"10 of 10 episodes were aborted, more than --max-aborted 5 %; 10 of them: {reason}")
    assert log == f"skd assess: log: {tmp_path / 'out' / 'logs' / 'car_controller.log'}"
    result = json.loads((tmp_path / "out" / "assessment.json").read_text())
    assert result["aborted_reasons"] == {"not a finite number": {"count": 10, "first": reason}}
