"""The smallest trial that tells two versions of a car apart, and its files: one car hits in it, the other does not."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_support import BRAKE, skd
from skd_evaluator import load_result
from skd_evaluator.margin.common_trajectories import distinguishing_trials
from skd_sim.world.episode import Mode

CARS = (
    BRAKE.format(name="Before", side=1.5)
    + '''

class After(Before):
    limit = 1.1


class Same(Before):
    """Another way to say the same."""

    def command(self, car, adversary):
        return super().command(car, adversary)
'''
)
SMALL = ("--safe-count", "1", "--kamikaze-count", "2", "--collision-runs", "1", "--margin-limit", "8", "--seed", "5")
ONCE = ("--safe-count", "1", "--kamikaze-count", "1", "--collision-runs", "1", "--margin-limit", "0", "--seed", "5")
GENERIC = ("--adversary-model", "generic", "--behaviour", "none", "-q")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the results of two cars, and with their comparison."""
    made = tmp_path_factory.mktemp("versions")
    (made / "versions.py").write_text(CARS, encoding="utf-8")
    for car in ("Before", "After"):
        arguments = ("--controller", f"./versions.py:{car}", *SMALL, *GENERIC)
        assert skd("assess", *arguments, "--out", car, cwd=made).returncode == 0
    assert skd("compare", "Before", "After", "--explain", "-q", "--out", "compared", cwd=made).returncode == 0
    return made


@pytest.fixture(scope="module")
def only_after(folder: Path) -> dict[str, Any]:
    """What the comparison says of the trial in which only the second car hits."""
    found = json.loads((folder / "compared" / "comparison.json").read_text())["only_one_hits"]
    assert [one["hits"] for one in found] == ["versions.py:Before", "versions.py:After"]
    return dict(found[1])


@pytest.mark.parametrize(("car", "hits"), [("Before", False), ("After", True)])
def test_any_command_drives_the_trial_again_to_the_bit(folder, only_after, tmp_path, car, hits):
    files = folder / "compared" / only_after["folder"]
    trial = ("--scenario", files / "scenario.yaml", "--safe", files / "trajectory.csv", "--controller")
    done = skd("assess", *trial, f"./versions.py:{car}", *ONCE, *GENERIC, "--out", tmp_path / "out", cwd=folder)
    assert done.returncode == 0, done.stderr
    episodes = load_result(tmp_path / "out").episodes
    (run,) = np.flatnonzero(episodes.mode == Mode.REPLAY)
    assert bool(episodes.hit[run]) is hits
    if hits:
        assert episodes.impact_speed[run] == only_after["impact_speed"]
        assert episodes.impact_time[run] == only_after["impact_time"]


def test_the_trajectory_deviates_from_its_safe_one_as_is_said(folder, only_after):
    safe = load_result(folder / "After").safe[only_after["safe_number"]]
    rows = np.loadtxt(folder / "compared" / only_after["folder"] / "trajectory.csv", delimiter=",", skiprows=1)
    walked, phi = rows[:, 1:], safe[np.minimum(np.arange(len(rows)), len(safe) - 1)]
    away = np.hypot(*(walked - phi).T)
    assert away[:-1].max() - 1e-9 <= only_after["deviation"] <= away.max() + 1e-9
    assert only_after["deviation"] < 5.0
    assert 0.0 < only_after["cars_part_at"] < only_after["impact_time"]


def test_the_written_test_fails_for_the_car_that_hits(folder, only_after):
    file = folder / "compared" / only_after["folder"] / "test_hit.py"
    words = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", file]
    done = subprocess.run(words, capture_output=True, check=False, cwd=folder, text=True)
    assert done.returncode == 1
    assert "AssertionError" in done.stdout
    assert str(folder) not in file.read_text()
    scenario = (file.parent / "scenario.yaml").read_text()
    assert scenario.startswith("name: ")
    assert "{" not in scenario


def test_nothing_tells_a_car_from_another_way_to_write_it(folder):
    before = load_result(folder / "Before")
    same = replace(before, figures={**before.figures, "controller": f"{folder}/versions.py:Same"})
    assert distinguishing_trials(before, same) == (None, None)
