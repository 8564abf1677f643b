"""What the terminal says of a campaign that came to nothing: who is to blame, and where more of it stands."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path

import pytest
from common import PATIENCE
from graph_support import HERE, Finished, skd


def assess(folder: Path, safe: Path, *options: object, timeout: float = PATIENCE) -> Finished:
    """Run a small campaign through the graph."""
    return skd(
        *("assess", "--graph", "--safe", safe, "--safe-count", 1, "--kamikaze-count", 2, "--collision-runs", 2),
        *("--simulations", 100, "--margin-limit", 0, "--behaviour", "none"),
        *("-p", f"startup_timeout:={timeout}", "-p", f"command_timeout:={timeout}", *options),
        *("--out", folder / "out"),
        environment={"PYTHONPATH": str(HERE / "controllers")},
    )


def test_nobody_drives(tmp_path: Path, safe: Path) -> None:
    """It says what it waits for, once, and does not wait for hours."""
    finished = assess(tmp_path, safe, "--adversary-model", "generic", "--controller", "external", timeout=1.0)
    assert finished.code == 1
    assert finished.lines[0].startswith("skd: waiting for a publisher of /ego/acceleration_command (ROS_DOMAIN_ID=")
    first, last = finished.timeless[1:]
    assert first.startswith("skd: an episode was aborted, the first one so: not started: the car controller")
    assert "3 starts in a row failed, the last one so: not started: the car controller" in last
    assert "no node publishes on /ego/acceleration_command" in last
    assert last.rpartition("; log: ")[0].endswith("; aborted were 3 not started")
    logs = tmp_path / "out" / "logs"
    for line in (first, last):  # nobody else was started, and so nobody has printed
        assert Path(line.rpartition("log: ")[2].partition("; ")[0]) == logs


def test_all_aborted(tmp_path: Path, safe: Path) -> None:
    finished = assess(tmp_path, safe, "--adversary-model", "generic", "--controller", "misbehaving:NeverWell")
    assert finished.code == 1
    first, *lost, undefined, aborted, log = finished.timeless
    assert [line.partition(" were aborted and count for nothing; no other")[1] != "" for line in lost] == [True] * 3
    reason = "not a finite number: the car controller commanded nan"
    assert undefined == f"skd assess: every kamikaze episode was aborted ({reason}); SKD is not defined"
    assert aborted.endswith(f"10 of 10 episodes were aborted, more than --max-aborted 5 %; 10 of them: {reason}")
    assert first.startswith(f"skd: an episode was aborted, the first one so: {reason}; log: ")
    assert log == (
        "skd assess: why episodes were aborted: 10 not a finite number; "
        f"log: {tmp_path / 'out' / 'logs' / 'car_controller.log'}"
    )
    result = json.loads((tmp_path / "out" / "assessment.json").read_text())
    assert result["aborted_reasons"] == {"not a finite number": {"count": 10, "first": reason}}


DIES = "import sys; print('brakes: no such device', file=sys.stderr); sys.exit(3)"


@pytest.mark.parametrize(
    ("command", "code", "said"),
    [
        ("no_such_command --fast", 2, ["car_controller cannot be started: No such file or directory: no_such_command"]),
        (
            shlex.join([sys.executable, "-c", DIES]),
            1,
            [
                "skd: process ended: car_controller ended with exit code 3; the end of ",
                "  | brakes: no such device",
                "skd: an episode was aborted, the first one so: process ended: car_controller ended with exit code 3",
                "process ended: car_controller ended with exit code 3",  # three starts in a row, or twenty of its own
            ],
        ),
    ],
)
def test_a_command_that_does_not_run(tmp_path: Path, safe: Path, command: str, code: int, said: list[str]) -> None:
    finished = assess(
        tmp_path, safe, "--adversary-model", "generic", "--controller", "external", "--controller-command", command
    )
    assert finished.code == code
    assert len(finished.timeless) == len(said)
    for line, wanted in zip(finished.timeless, said, strict=True):
        assert wanted in line
