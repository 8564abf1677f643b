"""Assessments of a user's controller that fails: one line says what and where, and no process is left behind."""

import contextlib
import json
import os
import signal
import time
from pathlib import Path

import pytest
from cli_support import CONTROLLERS, SMALL, one_line, skd, started
from common import PATIENCE, is_alive, wait_until

CARS = f"""{CONTROLLERS}
import ctypes, faulthandler, math, signal, subprocess

class RaisesLate(_Car):
    "Stands until a harmless run has become longer than any crossing."
    def late(self): return -1 / (self.calls < 60)
class Exits(_Car):
    def late(self): os._exit(0)
class Crashes(_Car):
    def late(self):
        faulthandler.disable()
        ctypes.string_at(0)
class Hangs(_Car):
    def late(self):
        while True: pass
class Nan(_Car):
    def late(self): return math.nan
class ExitsInInit(_Car):
    def __init__(self): os._exit(0)
class SometimesExits(_Car):
    "Every fourth process that is made for it ends in its second episode."
    def reset(self, scenario, rng):
        super().reset(scenario, rng)
        with open("episodes", "a") as file: file.write("x")
        if os.path.getsize("episodes") % 8 == 5: os._exit(7)
    def late(self): return 0.0

class Mother(_Car):
    "Starts a process, and another one that holds all its files."
    born = False
    def reset(self, scenario, rng):
        super().reset(scenario, rng)
        if not Mother.born:
            Mother.born = True
            sleeps = "import os, time; open('1', 'w').write(str(os.getpid())); time.sleep(1000)"
            subprocess.Popen([sys.executable, "-I", "-S", "-c", sleeps])
            if os.fork() == 0:
                signal.signal(signal.SIGTERM, signal.SIG_IGN)
                with open("2", "w") as file: file.write(str(os.getpid()))
                time.sleep(1000)
    def late(self):
        while not (os.path.exists("1") and os.path.exists("2")): time.sleep(0.01)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        if os.environ.get("END") == "wait": time.sleep(1000)
        return 0.0
"""


@pytest.fixture
def cars(here: Path) -> Path:
    (here / "cars.py").write_text(CARS)
    (here / "exits_at_import.py").write_text("import os; os._exit(0)\nclass Car: pass\n")
    return here


def words(name: str, *more: str) -> list[str]:
    controller = name if ":" in name else f"cars:{name}"
    return [
        "assess", *SMALL, "--safe", "good.csv", "--adversary-model", "generic", "--margin-limit", "0",
        "--controller", controller, "--out", "out", *more,
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "code", "parts"),
    [
        (
            "Raises",
            1,
            ["failed with ZeroDivisionError", "cars.py, line 14); in a nominal run: φ 0, trial 0, t = 0.60 s"],
        ),
        ("Exits", 1, ["3 episodes in a row failed", "process ended", "exit code 0"]),
        ("Crashes", 1, ["3 episodes in a row failed", "process ended", "SIGSEGV"]),
        ("Nan", 1, ["command must return a finite number (m/s²), or two", "(rad); got nan (cars.py"]),
        ("ExitsInInit", 2, ["cannot be loaded", "exit code 0"]),
        ("exits_at_import:Car", 2, ["cannot be loaded", "exit code 0"]),
    ],
)
def test_a_controller_that_fails_is_said_in_one_line(cars: Path, name: str, code: int, parts: list[str]) -> None:
    one_line(skd(*words(name), cwd=cars), code, name, *parts)
    assert not (cars / "out").exists()


def test_a_controller_that_fails_in_one_stage_keeps_its_other_figures_and_is_not_credible(cars: Path) -> None:
    done = skd(*words("RaisesLate", "--json"), cwd=cars)
    figures = json.loads(done.stdout)
    assert figures["price_note"].endswith("line 22); in a price run: empty road, trial 0, t = 17.70 s")
    assert figures["nominal_collision_rate"] is not None
    assert done.returncode == 1
    assert "not credible: controller cars:RaisesLate: command failed with ZeroDivisionError" in done.stderr


def test_a_controller_that_hangs_ends_the_assessment_in_one_line(cars: Path) -> None:
    done = skd(*words("Hangs", "--workers", "2", "-p", "startup_timeout:=1"), cwd=cars)
    one_line(done, 1, "3 episodes in a row failed", "a call took more than 1 s", "cars:Hangs")


def test_aborted_episodes_are_counted_and_too_many_fail(cars: Path) -> None:
    counts = ("--kamikaze-count", "6", "--collision-runs", "30")
    done = skd(*words("SometimesExits", *counts, "--json"), cwd=cars)
    kind = json.loads(done.stdout)["aborted_reasons"]["process ended"]
    assert kind["count"] >= 3
    assert "exit code 7 (controller cars:SometimesExits)" in kind["first"]
    assert done.returncode == 1
    assert "episodes were aborted, more than --max-aborted 5 %" in done.stderr
    assert (cars / "out" / "assessment.json").exists()
    done = skd(*words("SometimesExits", *counts, "--max-aborted", "40", "--overwrite", "--details"), cwd=cars)
    assert "--max-aborted" not in done.stderr  # what stands there is that the car does not repeat itself
    assert "aborted episodes: process ended" in done.stdout


def born(folder: Path) -> list[int]:
    """Return the ids of the processes that a controller has started."""
    return [int((folder / name).read_text() or 0) for name in ("1", "2") if (folder / name).exists()]


@contextlib.contextmanager
def nobody_is_left(folder: Path):
    try:
        yield
        assert len(born(folder)) == 2
        wait_until(lambda: not any(map(is_alive, born(folder))), "their end", 10.0)
    finally:
        for pid in filter(is_alive, born(folder)):
            os.kill(pid, signal.SIGKILL)


def test_what_a_controller_has_started_ends_with_the_assessment(cars: Path) -> None:
    with nobody_is_left(cars):
        done = skd(*words("Mother"), cwd=cars)
        assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_what_a_controller_has_started_ends_with_a_command_that_is_ended(cars: Path, number: int) -> None:
    with nobody_is_left(cars):
        running = started(*words("Mother"), cwd=cars, END="wait")
        wait_until(lambda: len(born(cars)) == 2, "the children")
        begin = time.monotonic()
        os.kill(running.pid, number)
        assert running.finish(PATIENCE).returncode == (-signal.SIGKILL if number == signal.SIGKILL else 130)
        assert time.monotonic() - begin < 20.0
