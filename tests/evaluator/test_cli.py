"""The command line as its user meets it: a process with arguments, an exit code and what it prints."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from skd_evaluator.cli.main import main
from skd_sim.scenario import load_scenario

SMALL = ["--safe-count", "1", "--kamikaze-count", "2", "--collision-runs", "3", "--simulations", "20", "--workers", "1"]
CROSSING = "t,x,y\n0,-3,0\n2,3,0\n"
CONTROLLERS = """
import os, sys, time

class _Car:
    def reset(self, scenario, rng):
        self.calls = 0
    def command(self, car, pedestrian):
        self.calls += 1
        return 0.0 if self.calls < 3 else self.late()

class Fine(_Car):
    def late(self): return 0.0
class Raises(_Car):
    def late(self): return 1 / 0
class GivesNone(_Car):
    def late(self): return None
class GivesNan(_Car):
    def late(self): return float("nan")
class Exits(_Car):
    def late(self): sys.exit(3)
class Dies(_Car):
    def late(self): os._exit(3)
class Sleeps(_Car):
    def late(self): time.sleep(100)
class NoCommand:
    def reset(self, scenario, rng): pass
class FailsInReset(_Car):
    def reset(self, scenario, rng): raise RuntimeError("no\\nstart")
"""


def skd(*arguments: str | Path, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "skd_evaluator", *map(str, arguments)],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(cwd), **environment},
        capture_output=True,
        text=True,
        timeout=120,
    )


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


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def one_line(done: subprocess.CompletedProcess[str], code: int, *parts: str) -> None:
    assert done.returncode == code, done
    lines = done.stderr.splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("skd"), lines
    for part in parts:
        assert part in lines[0]


@pytest.fixture
def here(tmp_path: Path) -> Path:
    (tmp_path / "cars.py").write_text(CONTROLLERS)
    (tmp_path / "good.csv").write_text(CROSSING)
    return tmp_path


# --- bad input


@pytest.mark.parametrize(
    ("content", "parts"),
    [
        (None, ["phi.csv", "No such file"]),
        ("a,b\n0,1\n", ["phi.csv, line 1", "'t'"]),
        ("t,x,y\n0,-3,0\n0.3,-2,0\noops,-1,0\n", ["phi.csv, line 4", "t must be a number", "'oops'"]),
        ("t,x,y\n0,-3,0\n0.3,nan,0\n0.6,3,0\n", ["phi.csv, line 3", "x must be finite", "nan"]),
        ("t,x,y\n0,-3,0\n", ["phi.csv", "1 point", "at least two"]),
        ("t,x,y\n0,-3,0\n3,-2,0\n", ["phi.csv", "never enters the car's path"]),
        ("t,x,y\n0,0,-14\n3,2,0\n", ["phi.csv", "where the car starts"]),
    ],
    ids=["missing", "columns", "malformed", "nan", "one-point", "beside", "in-the-car"],
)
def test_bad_safe_trajectory(here, skd_here, content, parts):
    if content is not None:
        (here / "phi.csv").write_text(content)
    one_line(skd_here("assess", *SMALL, "--safe", "phi.csv", "--out", "out"), 2, *parts)
    assert not (here / "out").exists()


def test_too_few_recorded_trajectories(here):
    done = skd("assess", "--safe", "good.csv", "--safe-count", "5", cwd=here)
    one_line(done, 2, "good.csv", "1 usable", "5 were asked for")
    assert not (here / "skd_results").exists()


def test_folder_without_csv(here, skd_here):
    (here / "folder").mkdir()
    one_line(skd_here("assess", "--safe", "folder"), 2, "no csv file")


def test_sweep_reads_recorded_trajectories_before_it_runs_anything(here):
    begin = time.monotonic()
    one_line(skd("sweep", "--safe", "missing.csv", "--simulations", "100000", cwd=here), 2, "missing.csv")
    assert time.monotonic() - begin < 60.0


def test_sweep_refuses_a_multiplier_given_twice(here):
    one_line(skd("sweep", "--multipliers", "1", "1.0", cwd=here), 2, "--multipliers", "twice")


def _edited(**car_or_walker: object) -> str:
    data = load_scenario("crossing").as_dict()
    for key, value in car_or_walker.items():
        section, name = key.split("__")
        data[section][name] = value
    return yaml.safe_dump(data)


@pytest.mark.parametrize(
    ("content", "parts"),
    [
        (None, ["scenario.yaml", "citr_crossing, crossing"]),
        ("a: [1\n", ["scenario.yaml", "not valid YAML"]),
        (_edited(car__wings=2), ["scenario.yaml", "unknown key car.wings"]),
        (_edited(pedestrian__radius=float("nan")), ["scenario.yaml", "pedestrian.radius", "nan"]),
        (_edited(pedestrian__start_x=0.0, pedestrian__start_y=-14.0), ["scenario.yaml", "overlaps the pedestrian"]),
    ],
    ids=["missing", "syntax", "unknown-key", "nan", "overlap"],
)
def test_bad_scenario(here, skd_here, content, parts):
    if content is not None:
        (here / "scenario.yaml").write_text(content)
    one_line(skd_here("assess", *SMALL, "--scenario", "scenario.yaml"), 2, *parts)


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("fast", ["unknown controller 'fast'", "basic"]),
        ("nowhere.at.all:Car", ["nowhere.at.all:Car", "ModuleNotFoundError"]),
        ("cars:Missing", ["cars:Missing", "Missing"]),
        ("cars:NoCommand", ["cars:NoCommand", "command(car, pedestrian)"]),
    ],
)
def test_bad_controller(here, name, parts):
    one_line(skd("assess", *SMALL, "--controller", name, cwd=here), 2, *parts)


def test_negative_multiplier(here):
    one_line(skd("assess", "--multiplier", "-0.5", cwd=here), 2, "--multiplier", "≥ 0", "'-0.5'")


WHOLE = ["--safe-count", "--kamikaze-count", "--collision-runs", "--simulations", "--workers", "--seed"]


@pytest.mark.parametrize("command", ["assess", "sweep"])
@pytest.mark.parametrize(
    ("option", "value"),
    [(option, value) for option in WHOLE for value in ("-1", "1.5", "many", "", "nan", "1" + 30 * "0")]
    + [(option, "0") for option in WHOLE if option != "--seed"]
    + [("--max-distance", value) for value in ("-1", "0", "nan", "inf", "far", "")],
)
def test_bad_number(capsys, command, option, value):
    with pytest.raises(SystemExit) as stop:
        main([command, f"{option}={value}"])
    assert stop.value.code == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert option in lines[0]
    assert repr(value) in lines[0]


def test_option_of_another_command(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["probe", "--car-model", "car_model.yaml"])
    assert stop.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("skd probe: error: unrecognized arguments: --car-model")
    assert "skd probe --help" in line


def test_misspelt_objective(capsys):
    """The choices are what the user types, not the names of Python objects."""
    with pytest.raises(SystemExit) as stop:
        main(["assess", "--objective", "frechett"])
    assert stop.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "'frechett'" in line
    assert "<" not in line
    for name in ("paper", "frechet"):
        assert name in line


@pytest.mark.parametrize("value", ["-1", "nan", "inf", "1e999", "much", ""])
def test_bad_multiplier(capsys, value):
    for arguments in (["assess", f"--multiplier={value}"], ["sweep", "--multipliers", "1", f"{value}"]):
        with pytest.raises(SystemExit) as stop:
            main(arguments)
        assert stop.value.code == 2
        assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.parametrize("arguments", [[], ["fly"], ["assess", "--wings"], ["assess", "--seed"], ["assess", "extra"]])
def test_wrong_usage(here, arguments):
    one_line(skd(*arguments, cwd=here), 2, "--help")


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
    (here / "scenario.yaml").write_text(_edited(collision__minimum_impact_speed=60.0))
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


def _until(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


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
        _until(lambda: len(_group(process.pid)) == 3 or process.poll() is not None)
        time.sleep(0.5)
        assert process.poll() is None, process.communicate()
        (os.killpg if to_all else os.kill)(process.pid, number)
        process.wait(20)
        _until(lambda: not _group(process.pid), 10)
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


# --- floor


def test_floor_is_refused_for_a_car_that_cannot_be_foretold(here):
    one_line(
        skd("assess", *SMALL, "--controller", "cars:Fine", "--floor", cwd=here), 2, "--floor", "basic", "cars:Fine"
    )
    external = ("assess", *SMALL, "--graph", "--controller", "external", "--floor")
    one_line(skd(*external, cwd=here), 2, "--floor", "basic", "external")
    assert not (here / "skd_results").exists()


def test_floor_is_refused_for_safe_trajectories_that_end_far_beyond_the_path(here):
    (here / "far.csv").write_text("t,x,y\n0,-3,0\n4,7,0\n")
    one_line(skd("assess", *SMALL, "--safe", "far.csv", "--floor", cwd=here), 2, "--floor", "3.5 m", "far", "5.6 m")
    assert not (here / "skd_results").exists()


def test_floor_is_reported(here):
    plain = ["assess", *SMALL, "--safe", "good.csv"]
    assert skd(*plain, "--out", "without", cwd=here).returncode == 0
    done = skd(*plain, "--floor", "--workers", "2", "--out", "with", cwd=here)
    assert done.returncode == 0, done.stderr
    assert "clairvoyant floor (m)" in done.stdout
    assert "closeness, SKD / floor" in done.stdout
    without, result = (json.loads((here / name / "assessment.json").read_text()) for name in ("without", "with"))
    figures = ("floor", "floor_ci95", "floor_missing", "closeness", "closeness_ci95")
    assert [without[name] for name in figures] == [None] * 5
    assert {name: result[name] for name in without if name not in (*figures, "seconds")} == {
        name: value for name, value in without.items() if name not in (*figures, "seconds")
    }
    with np.load(here / "with" / "episodes.npz") as episodes:
        floors = episodes["floor"][episodes["mode"] == 1]
        assert np.isnan(episodes["floor"][episodes["mode"] != 1]).all()
    assert 0.0 < floors.min() <= floors.max() <= 2.0 * result["skd"]
    assert skd(*plain, "--floor", "--workers", "1", "--out", "alone", cwd=here).returncode == 0
    with np.load(here / "alone" / "episodes.npz") as episodes:
        assert np.array_equal(episodes["floor"][episodes["mode"] == 1], floors)
    assert result["floor"] == pytest.approx(floors.mean(), rel=1e-12)
    assert result["floor_missing"] == 0
    assert result["closeness"] == pytest.approx(result["skd"] / result["floor"], rel=1e-12)
    assert result["closeness"] >= 1.0
    low, high = result["closeness_ci95"]
    assert low <= result["closeness"] <= high


def test_sweep_reports_the_floor(here):
    done = skd("sweep", *SMALL, "--multipliers", "0.5", "1.0", "--floor", "--out", "out", cwd=here)
    assert done.returncode == 0, done.stderr
    assert max(map(len, done.stdout.splitlines()[:7])) <= 80
    rows = json.loads((here / "out" / "sweep.json").read_text())["rows"]
    assert all(row["closeness"] == pytest.approx(row["skd"] / row["floor"], rel=1e-12) for row in rows)
