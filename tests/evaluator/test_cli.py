"""The command line as its user meets it: a process with arguments, an exit code and what it prints."""

import csv
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
import uuid
from pathlib import Path

import pytest
from cli_support import CONTROLLERS, SMALL, edited, names, one_line, skd, started
from common import PATIENCE, pids_with, wait_until
from forked_skd import TOKEN
from skd_evaluator.files import PREFIX


@pytest.mark.parametrize("out", ["/dev/null/x", "/proc/x", "good.csv", "a" * 300])
def test_unwritable_output(skd_here, out):
    one_line(skd_here("assess", *SMALL, "--out", out), 2, f"--out {out}")


def test_results_are_kept_unless_overwritten_and_foreign_files_always(here):
    first = skd("assess", *SMALL, "--out", "out", cwd=here)
    assert first.returncode == 0, first.stderr
    before = {path.name: path.read_bytes() for path in (here / "out").iterdir()}
    assert set(before) == {
        "assessment.json", "episodes.npz", "manifest.sha256", "surrogate_measures.csv", "trajectories.png",
        "trajectories_paper.png", "vulnerability.png",
    }  # fmt: skip
    (here / "out" / "note.txt").write_text("mine")

    one_line(skd("assess", *SMALL, "--out", "out", cwd=here), 2, "already holds results", "--overwrite")
    assert (here / "out" / "note.txt").exists()

    again = skd("assess", *SMALL, "--seed", "1", "--out", "out", "--overwrite", "--json", cwd=here)
    assert again.returncode == 0, again.stderr
    assert again.stderr == ""
    assert json.loads(again.stdout) == json.loads((here / "out" / "assessment.json").read_text())
    assert json.loads(again.stdout)["seed"] == 1
    assert set(names(here / "out")) == set(before)
    assert names(here) == ["good.csv", "my_cars.py", "out"]

    bare = skd("assess", *SMALL, "--no-pictures", "--out", "bare", cwd=here)
    assert bare.returncode == 0, bare.stderr
    assert names(here / "bare") == ["assessment.json", "episodes.npz", "manifest.sha256", "surrogate_measures.csv"]
    assert (here / "bare" / "episodes.npz").read_bytes() == before["episodes.npz"]


def test_user_controller_is_assessed(here):
    mine = ("--adversary-model", "generic", "--controller", "my_cars:Fine", "--safe", "good.csv", "--margin-limit", "0")
    done = skd("assess", *SMALL, *mine, "--details", "--no-pictures", "--out", "out", cwd=here)
    assert (done.returncode, done.stderr) == (0, "")
    result = json.loads((here / "out" / "assessment.json").read_text())
    assert (result["controller"], result["multiplier"]) == ("my_cars:Fine", None)
    assert (result["aborted_reasons"], result["commands_clipped"]) == ({}, {"commands": 0, "episodes": 0})
    low, high = result["skd_ci95_pairs"]  # the table shows these very figures
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("SKD (m)")]
    assert f"[{low:.3f}, {high:.3f}]" in line
    assert f"{100 * result['kamikaze_success_rate']:.1f} % of kamikazes collide" in line


def test_no_kamikaze_found(here):
    (here / "scenario.yaml").write_text(edited(collision__minimum_impact_speed=60.0))
    done = skd("assess", *SMALL, "--scenario", "scenario.yaml", "--out", "out", cwd=here)
    assert done.returncode == 0
    assert "no kamikaze trajectory was found; SKD is not defined" in done.stderr
    result = json.loads((here / "out" / "assessment.json").read_text())
    assert result["skd"] is None
    assert result["kamikaze_success_rate"] == 0.0
    assert result["kamikaze_trials"] == 4


def test_sweep(here):
    done = skd("sweep", *SMALL, "--multipliers", "0", "1.125", "--safe", "good.csv", "--out", "out", cwd=here)
    assert (done.returncode, done.stderr) == (0, "")
    assert max(map(len, done.stdout.splitlines()[:10])) <= 80
    rows = json.loads((here / "out" / "sweep.json").read_text())["rows"]
    assert [(row["kind"], row["multiplier"]) for row in rows] == [
        (kind, multiplier) for kind in ("synthetic", "recorded") for multiplier in (0.0, 1.125)
    ]
    for row in rows:
        folder = here / f"out/{row['kind']}/C_{row['multiplier']:g}"
        alone = json.loads((folder / "assessment.json").read_text())
        assert (alone["multiplier"], alone["controller"]) == (row["multiplier"], "basic")
        for key in ("pairs", "skd", "variance", "contact_rate", "margin"):
            assert row[key] == alone[key] is not None
    table = (here / "out" / "sweep.csv").read_text().splitlines()
    for line, row in zip(csv.DictReader(table), rows, strict=True):
        assert line["kind"] == row["kind"]
        assert [float(line[key]) for key in ("multiplier", "skd")] == [row["multiplier"], row["skd"]]
    # And what the terminal shows: C, the margin, and SKD ± half its interval.
    for row in rows:
        low, high = row["skd_ci95_pairs"]
        first = rf"^ *{row['multiplier']:.3f} +{row['margin']:.3f} "
        assert re.search(rf"{first}.* {row['skd']:.2f} ± {0.5 * (high - low):.2f}", done.stdout, re.MULTILINE)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
@pytest.mark.parametrize(
    ("name", "number", "to_all", "processes"),
    [  # two workers and their parent; each worker has a child for the user's code
        ("basic", signal.SIGINT, True, 3),
        ("basic", signal.SIGTERM, False, 3),
        ("my_cars:Sleeps", signal.SIGKILL, False, 5),
    ],
    ids=["ctrl-c", "terminate", "kill"],
)
def test_interrupted(here, name, number, to_all, processes):
    (here / "out").mkdir()
    (here / "out" / "assessment.json").write_text("old")
    (here / "work").mkdir()
    command = [
        sys.executable, "-m", "skd_evaluator", "assess", "--safe", "../good.csv", "--safe-count", "1", "--workers", "2",
        "--kamikaze-count", "100000", "--adversary-model", "generic", "--controller", name,
        "--out", "../out", "--overwrite",
    ]  # fmt: skip
    token = uuid.uuid4().hex
    variables = {**os.environ, "PYTHONPATH": str(here), "PYTHONDONTWRITEBYTECODE": "1", TOKEN: token}
    piped = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen(command, cwd=here / "work", env=variables, start_new_session=True, **piped)
    try:
        wait_until(lambda: len(pids_with(token)) >= processes or process.poll() is not None)
        time.sleep(0.5)
        assert process.poll() is None, process.communicate()
        (os.killpg if to_all else os.kill)(process.pid, number)
        process.wait(PATIENCE)
        wait_until(lambda: not pids_with(token))
        printed = process.communicate()
    finally:
        for member in pids_with(token):
            os.kill(member, signal.SIGKILL)
    if number != signal.SIGKILL:
        (said,) = [line for line in printed[1].splitlines() if not line.startswith("skd: ")]
        assert said.startswith("skd assess: interrupted; ")
        assert printed[0] == ""
        assert process.returncode == 130
    assert (here / "out" / "assessment.json").read_text() == "old"
    left = [name for name in names(here) if not name.startswith((PREFIX, "out.unfinished."))]
    assert left == ["good.csv", "my_cars.py", "out", "work"]
    assert names(here / "work") == []
    assert names(here / "out") == ["assessment.json"]


def test_an_interrupted_assessment_is_resumed_and_gives_the_same(here):
    """What has run is kept, and not run again; to begin anew without a word, or with another seed, is refused."""
    counting = "class Counts(Fine):\n    def reset(self, scenario, rng):\n        super().reset(scenario, rng)\n"
    counting += "        open('/dev/shm/' + os.environ['N'], 'a').write('x')\n"
    (here / "my_cars.py").write_text(CONTROLLERS + counting)
    counted = Path("/dev/shm") / f"skd-{here.name}-{os.getpid()}"
    command = ["assess", *SMALL, "--kamikaze-count", "300", "--safe", "good.csv", "--adversary-model", "generic"]
    command += ["--controller", "./my_cars.py:Counts", "--out", "out", "--margin-limit", "0"]
    try:
        process = started(*command, cwd=here, N=counted.name)
        wait_until(lambda: (counted.exists() and counted.stat().st_size > 60) or process.has_ended())
        os.kill(process.pid, signal.SIGINT)
        done = process.finish(PATIENCE)
        assert done.returncode == 130
        (line,) = [line for line in done.stderr.splitlines() if not line.startswith("skd: ")]
        said = r"interrupted; (\d+) episodes kept in out\.unfinished\.sqlite; .*; go on with: skd assess --resume out$"
        kept = int(re.search(said, line)[1])
        assert kept > 20
        one_line(skd(*command, cwd=here, N=counted.name), 2, "was interrupted; --resume goes on with it")
        changed = skd("assess", "--resume", "out", "--seed", "5", cwd=here, N=counted.name)
        one_line(changed, 2, "--seed was 0 and is now 5; leave it out")
        one_line(skd("assess", "--resume", "other", cwd=here), 2, "nothing to go on with in other")
        one_line(skd("assess", "--resume", cwd=here), 2, "nothing in skd_results was interrupted")
        (here / "elsewhere").mkdir()
        one_line(skd("assess", "--resume", "../out", cwd=here / "elsewhere"), 2, f"was begun in {here}")
        code = (here / "my_cars.py").read_text()
        (here / "my_cars.py").write_text(f"{code}\n")
        one_line(skd("assess", "--resume", "--out", "out", cwd=here), 2, ": my_cars.py has changed; put it back")
        (here / "my_cars.py").write_text(code)
        (here / "notes.py").write_text("")
        assert not (here / "out").exists()
        before = counted.stat().st_size
        done = skd("assess", "--resume", "out", "--json", cwd=here, N=counted.name)
        assert done.returncode == 0, done.stderr
        assert "not taken for a part of the car: notes.py\n" in done.stderr  # nor is the file of kept episodes
        resumed, run = json.loads(done.stdout), counted.stat().st_size - before
        assert resumed["provenance"]["command"] == shlex.join(["skd", *map(str, command)])
        assert not list(here.glob(f"{PREFIX}*"))
        assert not list(here.glob("*.sqlite*"))
        before = counted.stat().st_size
        whole = json.loads(skd(*command[:-4], "--json", "--margin-limit", "0", cwd=here, N=counted.name).stdout)
        assert counted.stat().st_size - before >= run + kept - 1
        assert {key for key in whole if whole[key] != resumed[key]} <= {"seconds", "provenance"}
    finally:
        counted.unlink(missing_ok=True)
    one_line(skd(*command, "--resume", cwd=here), 2, "it is complete")
