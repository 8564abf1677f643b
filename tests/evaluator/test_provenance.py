"""Results say what they are of: by a schema, and by what ran, when and where."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import pytest
from cli_support import CONTROLLERS, SMALL
from common import assert_valid
from skd_evaluator.provenance import controller_files, controller_revision, git_revision, provenance, surroundings_of
from skd_sim.choices.car_under_test import EXTERNAL, CarUnderTest


def content(folder: Path) -> dict[str, object]:
    return json.loads((folder / "assessment.json").read_text(encoding="utf-8"))


def test_an_assessment_says_what_ran(skd_here, here, monkeypatch):
    monkeypatch.syspath_prepend(here)
    begin = datetime.now(UTC).replace(microsecond=0)
    command = ["assess", *SMALL, "--curve", "--margin-limit", "20", "--safe", "good.csv", "--objective"]
    done = skd_here(
        *command, "deformation", "--knowledge", "nothing", "--controller", "my_cars:Fine", "--out", "out dir"
    )
    assert done.returncode == 0, done.stderr
    result = content(here / "out dir")
    assert_valid(result)
    assert done.stdout.splitlines()[-1] == f"{result['seconds']:.1f} s; results in out dir"
    said = result["provenance"]
    assert begin <= datetime.fromisoformat(said["date"]) <= datetime.now(UTC)
    assert said["command"].startswith("skd assess --safe-count 1 ")
    assert "--out 'out dir'" in said["command"]
    assert Path(said["folder"]) == here
    digest = hashlib.sha256(CONTROLLERS.encode()).hexdigest()
    assert said["controller_files"][0] == {"path": str(here / "my_cars.py"), "sha256": digest}
    assert [one["path"] for one in said["controller_files"][1:]] == [str(here / "good.csv")]  # no result of it
    assert said["car_model_sha256"] is None


def test_a_folder_whose_name_is_no_text_is_said_in_escapes(skd_here, here, monkeypatch):
    """Linux takes any bytes for a name; JSON has to be read by others."""
    odd = here / os.fsdecode(b"\xffodd")
    odd.mkdir()
    (odd / "strange_cars.py").write_text(CONTROLLERS)
    monkeypatch.syspath_prepend(odd)
    quick = ("--margin-limit", "0", "--knowledge", "nothing", "--behaviour", "none")
    done = skd_here("assess", *SMALL, *quick, "--controller", "strange_cars:Fine", "--out", here / "out")
    assert done.returncode == 0, done.stderr
    said = content(here / "out")["provenance"]
    assert said["controller_files"][0]["path"] == f"{here}/\\xffodd/strange_cars.py"
    monkeypatch.chdir(odd)
    assert surroundings_of(["skd"])["folder"] == f"{here}/\\xffodd"


def test_every_part_of_a_sweep_is_an_assessment(skd_here, here):
    done = skd_here("sweep", *SMALL, "--multipliers", "1", "1.125", "--out", "out", "--json")
    assert done.returncode == 0
    assert all("times the margin" in line for line in done.stderr.splitlines())
    parts = sorted((here / "out").rglob("assessment.json"))
    assert len(parts) == 2
    for part in parts:
        result = content(part.parent)
        assert_valid(result)
        assert result["provenance"] == json.loads(done.stdout)["provenance"]
    for change in ({"collision_rate": 1.2}, {"skd_ci95_pairs": [1.0]}, {"skd": "3"}, {"new": 1}, {"provenance": {}}):
        with pytest.raises(AssertionError):
            assert_valid({**result, **change})
    for name in ("skd", "objectives", "provenance", "deformation_ci95"):
        with pytest.raises(AssertionError):
            assert_valid({key: value for key, value in result.items() if key != name})


def test_a_controller_s_file_is_found_without_running_it(tmp_path, monkeypatch):
    package = tmp_path / "fleet" / "cars"
    package.mkdir(parents=True)
    for file in (tmp_path / "fleet" / "__init__.py", package / "__init__.py", package / "fast.py"):
        file.write_text("raise SystemExit('imported')\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert controller_files(CarUnderTest("fleet.cars.fast:Car")) == [package / "fast.py"]
    assert controller_files(CarUnderTest("fleet.cars:Car")) == [package / "__init__.py"]
    assert controller_files(CarUnderTest("fleet.nowhere.fast:Car")) == []
    assert controller_files(CarUnderTest("nowhere:Car")) == []
    (basic,) = controller_files(CarUnderTest())
    assert basic.name == "basic.py"
    assert "fleet" not in sys.modules


def test_files_that_a_command_line_names(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my node.py").write_text("1")
    (tmp_path / "gains.yaml").write_text("2")
    car = CarUnderTest(EXTERNAL)
    command = "python3 'my node.py' --ros-args --params-file ./gains.yaml gains.yaml --log-level info /dev/null ."
    assert controller_files(car, command) == [tmp_path / "my node.py", tmp_path / "gains.yaml"]
    assert controller_files(car, "python3 'unfinished") == []
    assert controller_files(car) == []
    said = provenance(["skd", "assess"], car, controller_command="./gains.yaml", car_model="{}")
    assert said["controller_files"][0]["sha256"] == hashlib.sha256(b"2").hexdigest()
    assert said["car_model_sha256"] == hashlib.sha256(b"{}").hexdigest()


def test_git_revision_is_of_the_checkout_that_the_code_is_in(tmp_path, monkeypatch):
    code = tmp_path / "package" / "code.py"
    code.parent.mkdir()
    code.write_text("1\n")
    assert git_revision(code) is None  # nobody's checkout

    def git(*words: str) -> str:
        identity = ["-c", "user.name=n", "-c", "user.email=e", "-c", "commit.gpgsign=false"]
        return subprocess.run(
            ["git", "-C", tmp_path, *identity, *words], check=True, capture_output=True, text=True
        ).stdout

    git("init", "-q")
    assert git_revision(code) is None  # an installation inside of one
    git("add", ".")
    git("commit", "-qm", "first")
    monkeypatch.setenv("GIT_DIR", "/nowhere")  # as inside a hook
    first = git_revision(code)
    monkeypatch.delenv("GIT_DIR")
    assert first == {"revision": git("rev-parse", "HEAD").strip(), "modified": False}
    code.write_text("2\n")
    assert git_revision(code) == {**first, "modified": True}


def test_the_commit_of_a_car_is_that_of_its_own_checkout(tmp_path, monkeypatch):
    (tmp_path / "car_of_mine.py").write_text("class Car: ...\n")
    git = ("git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false")
    for words in (("init", "-q"), ("add", "."), ("commit", "-q", "-m", "one")):
        subprocess.run([*git, *words], check=True)
    head = subprocess.run([*git, "rev-parse", "HEAD"], check=True, capture_output=True, text=True).stdout.strip()
    monkeypatch.syspath_prepend(str(tmp_path))
    car, own = CarUnderTest("car_of_mine:Car"), {"revision": "0" * 40, "modified": False}
    assert controller_revision(car, "", own) == {"revision": head, "modified": False}
    (tmp_path / "car_of_mine.py").write_text("class Car: pass\n")
    assert controller_revision(car, "", own) == {"revision": head, "modified": True}
    assert controller_revision(CarUnderTest("basic"), "", own) == own
    assert controller_revision(CarUnderTest("external"), "python3 no_such_file.py", own) is None
