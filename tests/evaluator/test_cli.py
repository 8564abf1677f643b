"""The command line as its user meets it: a process with arguments, an exit code and what it prints."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from cli_support import SMALL, edited, names, one_line, skd
from common import PATIENCE, wait_until

# --- the output folder


@pytest.mark.parametrize("out", ["/dev/null/x", "/proc/x", "good.csv", "a" * 300])
def test_unwritable_output(skd_here, out):
    one_line(skd_here("assess", *SMALL, "--out", out), 2, f"--out {out}")


@pytest.mark.skipif(os.geteuid() == 0, reason="permissions do not bind root")
def test_output_without_permission(here):
    (here / "closed").mkdir(mode=0o500)
    one_line(skd("assess", *SMALL, "--out", "closed/out", cwd=here), 2, "closed/out", "Permission denied")


def test_results_are_kept_unless_overwritten_and_foreign_files_always(here):
    first = skd("assess", *SMALL, "--out", "out", cwd=here)
    assert first.returncode == 0, first.stderr
    before = {path.name: path.read_bytes() for path in (here / "out").iterdir()}
    assert set(before) == {"assessment.json", "episodes.npz", "trajectories.png"}
    (here / "out" / "note.txt").write_text("mine")

    one_line(skd("assess", *SMALL, "--out", "out", cwd=here), 2, "already holds results", "--overwrite")
    assert (here / "out" / "note.txt").exists()

    again = skd("assess", *SMALL, "--seed", "1", "--out", "out", "--overwrite", "--json", cwd=here)
    assert again.returncode == 0, again.stderr
    assert again.stderr == ""
    assert json.loads(again.stdout) == json.loads((here / "out" / "assessment.json").read_text())
    assert json.loads(again.stdout)["seed"] == 1
    assert set(names(here / "out")) == set(before)
    assert names(here) == ["cars.py", "good.csv", "out"]

    (here / "foreign").mkdir()
    (here / "foreign" / "thesis.txt").write_text("years of work")
    for extra in ([], ["--overwrite"]):
        one_line(skd("assess", *SMALL, "--out", "foreign", *extra, cwd=here), 2, "holds no SKD results")
    assert names(here / "foreign") == ["thesis.txt"]


# --- controllers of the user


@pytest.mark.parametrize(
    ("name", "workers", "parts"),
    [
        ("Raises", "1", ["command failed with ZeroDivisionError", "cars.py, line"]),
        ("Raises", "2", ["command failed with ZeroDivisionError", "cars.py, line"]),
        ("GivesNone", "2", ["finite number", "None"]),
        ("GivesNan", "1", ["finite number", "nan"]),
    ],
)
def test_failing_controller(here, name, workers, parts):
    done = skd(
        "assess", *SMALL, "--workers", workers, "--safe", "good.csv", "--controller", f"cars:{name}", "--out", "out",
        cwd=here,
    )  # fmt: skip
    one_line(done, 1, f"cars:{name}", *parts)
    assert not (here / "out").exists()


@pytest.mark.parametrize(
    ("name", "workers", "parts"),
    [
        ("Exits", "2", ["cars:Exits", "SystemExit: 3"]),
        ("FailsInReset", "1", ["cars:FailsInReset", "reset failed with RuntimeError: no start"]),
        ("Dies", "2", ["worker process died"]),
    ],
)
def test_controller_that_ends_the_process(here, name, workers, parts):
    controller = ["--controller", f"cars:{name}", "--workers", workers, "--safe", "good.csv"]
    one_line(skd("assess", *SMALL, *controller, cwd=here), 1, *parts)


def test_user_controller_is_assessed(here):
    done = skd("assess", *SMALL, "--controller", "cars:Fine", "--safe", "good.csv", "--out", "out", cwd=here)
    assert (done.returncode, done.stderr) == (0, "")
    result = json.loads((here / "out" / "assessment.json").read_text())
    assert (result["controller"], result["multiplier"]) == ("cars:Fine", None)


# --- what an assessment can end with


def test_no_kamikaze_found(here):
    (here / "scenario.yaml").write_text(edited(collision__minimum_impact_speed=60.0))
    done = skd("assess", *SMALL, "--scenario", "scenario.yaml", "--out", "out", cwd=here)
    one_line(done, 1, "no kamikaze trajectory was found")
    result = json.loads((here / "out" / "assessment.json").read_text())
    assert result["skd"] is None
    assert result["kamikaze_success_rate"] == 0.0
    assert result["kamikaze_attempts"] == 4


def test_everything_discarded_by_distance(here):
    done = skd("assess", *SMALL, "--max-distance", "0.001", "--out", "out", cwd=here)
    one_line(done, 1, "all 2 are further than the maximum distance")


def test_sweep(here):
    done = skd("sweep", *SMALL, "--multipliers", "0", "1.125", "--safe", "good.csv", "--out", "out", cwd=here)
    assert (done.returncode, done.stderr) == (0, "")
    assert max(map(len, done.stdout.splitlines()[:10])) <= 80
    rows = json.loads((here / "out" / "sweep.json").read_text())["rows"]
    assert [(row["kind"], row["multiplier"]) for row in rows] == [
        (kind, multiplier) for kind in ("synthetic", "recorded") for multiplier in (0.0, 1.125)
    ]
    for row in rows:
        alone = json.loads((here / f"out/{row['kind']}/C_{row['multiplier']:g}/assessment.json").read_text())
        assert {key: alone[key] for key in row if key != "kind"} == {k: v for k, v in row.items() if k != "kind"}
    assert len((here / "out" / "sweep.csv").read_text().splitlines()) == 5


def test_sweep_whose_figures_do_not_vary(here):
    """Spearman's ρ is not defined where every collision rate is the same."""
    sizes = ["--safe-count", "1", "--kamikaze-count", "1", "--collision-runs", "1", "--simulations", "5"]
    done = skd("sweep", *sizes, "--workers", "1", "--multipliers", "3", "4", "5", "--json", cwd=here)
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["spearman_with_multiplier"]["synthetic"]["collision_rate"] is None


def test_reader_of_the_pipe_goes_away(here):
    command = [sys.executable, "-m", "skd_evaluator", "assess", *SMALL, "--json"]
    with subprocess.Popen(command, cwd=here, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        process.stdout.close()
        assert process.stderr.read() == ""


# --- interruption


def _group(leader: int) -> list[int]:
    """Return the living processes of a process group."""
    members = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[2]) == leader and fields[0] != "Z":
            members.append(int(stat.parent.name))
    return members


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
@pytest.mark.parametrize(
    ("name", "number", "to_all"),
    [
        ("basic", signal.SIGINT, True),
        ("basic", signal.SIGTERM, False),
        ("cars:Sleeps", signal.SIGINT, False),
        ("cars:Sleeps", signal.SIGKILL, False),
    ],
    ids=["ctrl-c", "terminate", "slow-controller", "kill"],
)
def test_interrupted(here, name, number, to_all):
    (here / "out").mkdir()
    (here / "out" / "assessment.json").write_text("old")
    (here / "work").mkdir()
    command = [
        sys.executable, "-m", "skd_evaluator", "assess", "--safe", "../good.csv", "--safe-count", "1", "--workers", "2",
        "--kamikaze-count", "100000", "--controller", name, "--out", "../out", "--overwrite",
    ]  # fmt: skip
    process = subprocess.Popen(
        command,
        cwd=here / "work",
        env={**os.environ, "PYTHONPATH": str(here), "PYTHONDONTWRITEBYTECODE": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        wait_until(lambda: len(_group(process.pid)) == 3 or process.poll() is not None)
        time.sleep(0.5)
        assert process.poll() is None, process.communicate()
        (os.killpg if to_all else os.kill)(process.pid, number)
        process.wait(PATIENCE)
        wait_until(lambda: not _group(process.pid))
        printed = process.communicate()
    finally:
        for member in _group(process.pid):
            os.kill(member, signal.SIGKILL)
    if number != signal.SIGKILL:
        assert printed == ("", "skd assess: interrupted; nothing was written\n")
        assert process.returncode == 130
    assert (here / "out" / "assessment.json").read_text() == "old"
    assert names(here) == ["cars.py", "good.csv", "out", "work"]
    assert names(here / "work") == []
    assert names(here / "out") == ["assessment.json"]


# --- help


def test_version_and_help(here):
    done = skd("--version", cwd=here)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("skd ")
    listing = skd("--help", cwd=here).stdout
    for command in ("assess", "sweep"):
        assert command in listing
        done = skd(command, "--help", cwd=here)
        assert (done.returncode, done.stderr) == (0, "")
        assert "--out" in done.stdout
