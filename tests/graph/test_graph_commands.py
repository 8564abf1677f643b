"""Commands that run a graph: what a campaign that came to nothing says, resuming, repeatability, driving by keys."""

import json
import shlex
import signal
import sys
import uuid
from pathlib import Path

import pytest
from common import PATIENCE, new_domain, wait_until
from forked_skd import TOKEN
from graph_support import HERE, Finished, Skd, assert_all_gone, assert_same_results, skd, skd_command
from skd_evaluator.assessment.files.episode_store import FILE_NAME
from skd_evaluator.metrics.aborted import NOT_CREDIBLE
from terminals import Terminal


def assess(folder: Path, safe: Path, *options: object, timeout: float = PATIENCE) -> Finished:
    return skd(
        *("assess", "--graph", "--safe", safe, "--safe-count", 1, "--kamikaze-count", 2, "--collision-runs", 2),
        *("--simulations", 100, "--margin-limit", 0, "--behaviour", "none"),
        *("-p", f"startup_timeout:={timeout}", "-p", f"command_timeout:={timeout}", *options),
        *("--out", folder / "out"),
        environment={"PYTHONPATH": str(HERE / "controllers")},
    )


UNKNOWN = ("--adversary-model", "generic", "--controller", "external")


def test_nobody_drives(tmp_path: Path, safe: Path) -> None:
    """It says what it waits for, once, and does not wait for hours."""
    finished = assess(tmp_path, safe, *UNKNOWN, timeout=1.0)
    assert finished.code == 1
    assert finished.lines[0].startswith("skd: waiting for a publisher of /ego/acceleration_command (ROS_DOMAIN_ID=")
    first, last = finished.timeless[1:]
    assert first.startswith("skd: an episode was aborted, the first one so: not started: the car controller")
    assert "3 episodes in a row failed, the last one so: not started: the car controller" in last
    assert "no node publishes on /ego/acceleration_command" in last
    assert last.rpartition("; log: ")[0].endswith("; aborted episodes: 3 not started")
    logs = tmp_path / "out" / "logs"
    for line in (first, last):  # nobody else was started, and so nobody has printed
        assert Path(line.rpartition("log: ")[2].partition("; ")[0]) == logs


def test_all_aborted(tmp_path: Path, safe: Path) -> None:
    finished = assess(tmp_path, safe, "--adversary-model", "generic", "--controller", "misbehaving:NeverWell")
    assert finished.code == 1
    first, *_steps, lost, aborted, failed, log = finished.timeless
    assert lost == "skd assess: warning: all episodes of the planned deviation, SKD, the contact rate were aborted"
    reason = "not a finite number: the car controller commanded nan"
    assert aborted.endswith(f"10 of 10 episodes were aborted, more than --max-aborted 5 %; 10 of them: {reason}")
    assert failed.startswith("skd assess: not credible: controller misbehaving:NeverWell: command must return a finite")
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
    finished = assess(tmp_path, safe, *UNKNOWN, "--controller-command", command)
    assert finished.code == code
    assert len(finished.timeless) == len(said)
    for line, wanted in zip(finished.timeless, said, strict=True):
        assert wanted in line


SIZES = {"safe_count": 1, "kamikaze_count": 30, "collision_runs": 2, "simulations": 500, "objective": "deviation"}
SIZES |= {"behaviour": "none", "margin_limit": 0}
EPISODES = 30 + 2
BATCH = 20_000  # bytes, with some episodes in them


def test_a_campaign_of_graphs_that_is_killed_goes_on(tmp_path: Path, safe: Path) -> None:
    """It comes to what one in process does that nobody disturbed."""
    (tmp_path / "campaign.yaml").write_text(f"defaults: {json.dumps({**SIZES, 'safe': str(safe), 'graph': True})}\n")
    words = ("campaign", tmp_path / "campaign.yaml", "--out", tmp_path / "out", "-q", "--resume")
    wal = tmp_path / "out" / f"{FILE_NAME}-wal"
    campaign = Skd(*words)
    wait_until(lambda: campaign.has_ended() or (wal.exists() and wal.stat().st_size > BATCH))
    campaign.send_signal(signal.SIGKILL)
    assert campaign.finish().code == -signal.SIGKILL  # which sees that nothing is left
    resumed = skd(*words)
    assert resumed.code == 0, resumed.err
    content = json.loads((tmp_path / "out" / "campaign.json").read_text())
    assert content["episodes_read"] > 0
    assert content["episodes_run"] + content["episodes_read"] == EPISODES
    assert not list((tmp_path / "out").glob(".skd-*"))
    options = [word for key, value in SIZES.items() for word in (f"--{key.replace('_', '-')}", value)]
    whole = tmp_path / "whole"
    assert skd("assess", *options, "--safe", safe, "--workers", 1, "--out", whole).code == 0
    assert_same_results(tmp_path / "out" / "basic-C1", whole)


NODE = [sys.executable, "-m", "skd_sim.ros.controller_node", "--ros-args", "-p"]
PATHS = {"PYTHONPATH": str(HERE / "controllers")}
SMALL = (
    *("--safe-count", 1, "--kamikaze-count", 4, "--collision-runs", 12, "--simulations", 20, "--seed", 2),
    *("--margin-limit", 0, "--behaviour", "none", "--adversary-model", "generic"),
)


def test_a_car_that_keeps_something_is_not_credible(tmp_path: Path, safe: Path) -> None:
    out, command = tmp_path / "out", shlex.join([*NODE, "controller:=misbehaving:Counting"])
    car = ("--controller", "external", "--controller-command", command)
    done = skd("assess", "--graph", "--safe", safe, *SMALL, *car, "--out", out, environment=PATHS)
    found = json.loads((out / "assessment.json").read_text())["warnings"]
    (line,) = [line for line in found if line.startswith(NOT_CREDIBLE)]
    assert done.code == 1, done.err
    assert "episodes ended differently in another order" in line
    assert line in done.err


VENDOR = shlex.join([sys.executable, str(Path(HERE).parents[1] / "examples/vendor_controller/vendor_controller.py")])
DRIVEN = ("--graph", "--controller", "external", "--controller-command")


def test_a_node_is_driven_by_keys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    token = uuid.uuid4().hex
    variables = {TOKEN: token, "ROS_DOMAIN_ID": str(new_domain()), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    terminal = Terminal(skd_command("drive", *DRIVEN, VENDOR), **variables)
    terminal.wait_for("press a key to begin")
    terminal.press("s")
    terminal.wait_for(r"command [+-]\d")  # it hears the node
    terminal.wait_for(r"time [1-9]")
    assert "age of the command 0." in terminal.text
    terminal.press("r")
    terminal.wait_for(r"time 0\.\d s +speed 8")  # the next has begun, with the same processes
    terminal.press("q")
    assert terminal.finish() == 0
    assert_all_gone(token)
    assert list(tmp_path.iterdir()) == []
