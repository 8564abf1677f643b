"""Where a result comes from: hashes of the car's files, and its provenance."""

import json
import sys
from datetime import UTC, datetime
from pathlib import Path

import pytest
from cli_support import SMALL, git
from common import assert_valid
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.dask_cluster import _have, sent
from skd_evaluator.assessment.stages.car_model import model_file
from skd_evaluator.provenance import code_paths, git_revision
from skd_sim import UsageError, load_scenario
from skd_sim.options.car_and_adversary import EXTERNAL, AdversaryModel, CarUnderTest

CROSSING = load_scenario("crossing")
CAR, FLEET = CarUnderTest("netcar:Car"), CarUnderTest("fleet.cars.fast:Car")


def put(path: Path, text: str = "1\n") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def cars(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A module of a user's, and a package beside it; nothing of them is run."""
    folder = tmp_path / "cars"
    for name in ("netcar.py", "fleet/__init__.py", "fleet/cars/__init__.py", "fleet/cars/fast.py"):
        put(folder / name, "raise SystemExit('nobody runs this')\n")
    monkeypatch.syspath_prepend(str(folder))
    return folder


def kept(car: CarUnderTest = CAR, command: str | None = None) -> Path | None:
    """Return the folder in which the model of a car is kept."""
    graph = None if command is None else {"controller_command": command}
    return model_file(Plan(CROSSING, controller=car.controller, adversary_model=AdversaryModel.LEARNED), graph)


@pytest.mark.parametrize(
    ("car", "name"),
    [
        (CAR, "netcar.py"),
        (CAR, "net.onnx"),
        (CAR, "nets/deep/weights.bin"),
        (CAR, "fleet/cars/fast.py"),
        (FLEET, "fleet/nets/gains.yaml"),
    ],
)
def test_another_car_has_another_model(cars: Path, car: CarUnderTest, name: str) -> None:
    found = []
    for text in ("30 8", "7 3"):
        put(cars / name, text)
        found.append(kept(car))
    assert None not in found
    assert found[0] != found[1]
    put(cars / name, "30 8")
    assert kept(car) == found[0]


@pytest.mark.parametrize(
    ("car", "name"),
    [
        (CAR, "run.log"),
        (CAR, ".notes"),
        (CAR, "__pycache__/netcar.cpython-311.pyc"),
        (FLEET, "netcar.py"),
        (FLEET, "fleet/.git/HEAD"),
    ],
)
def test_what_is_written_beside_a_car_makes_it_no_other(cars: Path, car: CarUnderTest, name: str) -> None:
    before = kept(car)
    put(cars / name, "2\n")
    assert kept(car) == before is not None


def test_results_beside_a_car_make_it_no_other(cars: Path) -> None:
    before = kept()
    for name in ("out/assessment.json", "out/manifest.sha256", "out/bags/x.mcap", "cells/cells.json", "cells/basic/x"):
        put(cars / name)
    assert kept() == before is not None


def test_weights_behind_a_link_count(cars: Path, tmp_path: Path) -> None:
    put(tmp_path / "store" / "weights.bin", "30 8")
    (cars / "fleet" / "net").symlink_to(tmp_path / "store")
    before = kept(FLEET)
    put(tmp_path / "store" / "weights.bin", "7 3")
    assert kept(FLEET) != before


def test_a_node_is_known_by_what_its_command_names(cars: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    put(tmp_path / "stack" / "node.py")
    gains = put(tmp_path / "gains.yaml")
    weights = put(tmp_path / "nets" / "weights.bin")
    node = CarUnderTest(EXTERNAL)

    def paths(command: str) -> list[Path]:
        return code_paths(node, command)

    assert paths("python3 stack/node.py --ros-args") == [tmp_path / "stack" / "node.py"]
    command = f"{sys.executable} -m fleet --params:=gains.yaml --net nets"
    assert paths(command) == [cars / "fleet", gains, weights.parent]
    assert paths("python3 'unfinished") == paths("drive ~nobody-of-that-name/x") == []
    before = kept(node, "drive --net nets")
    put(weights, "7 3")
    assert kept(node, "drive --net nets") != before is not None


def test_a_worker_with_other_files_beside_the_module_is_refused(cars: Path) -> None:
    put(cars / "weights.bin", "30 8")
    controller = sent(CAR)
    _have(controller)
    put(cars / "weights.bin", "7 3")
    with pytest.raises(UsageError, match="has other files of the controller netcar:Car"):
        _have(controller)


def content(folder: Path) -> dict[str, object]:
    return json.loads((folder / "assessment.json").read_text(encoding="utf-8"))


def test_an_assessment_says_what_ran(skd_here, here, monkeypatch):
    monkeypatch.syspath_prepend(here)
    begin = datetime.now(UTC).replace(microsecond=0)
    command = ["assess", *SMALL, "-p", "curve:=true", "--margin-limit", "20", "--safe", "good.csv", "--out", "out dir"]
    car = ("--objective", "deviation", "--adversary-model", "generic", "--controller", "my_cars:Fine")
    done = skd_here(*command, *car)
    assert done.returncode == 0, done.stderr
    result = content(here / "out dir")
    assert_valid(result)
    assert done.stdout.splitlines()[-1].startswith(f"{result['seconds']:.1f} s; results in out dir; --details")
    said = result["provenance"]
    assert begin <= datetime.fromisoformat(said["date"]) <= datetime.now(UTC)
    assert said["command"].startswith("skd assess --safe-count 1 ")
    assert "--out 'out dir'" in said["command"]
    assert Path(said["folder"]) == here
    assert [one["path"] for one in said["controller_files"]] == [str(here / "my_cars.py")]
    assert said["car_model_sha256"] is None


def test_git_revision_is_of_the_checkout_that_the_code_is_in(tmp_path, monkeypatch):
    code = tmp_path / "package" / "code.py"
    code.parent.mkdir()
    code.write_text("1\n")
    assert git_revision(code) is None  # nobody's checkout

    git(tmp_path, "init", "-q")
    assert git_revision(code) is None  # an installation inside of one
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-qm", "first")
    monkeypatch.setenv("GIT_DIR", "/nowhere")  # as inside a hook
    first = git_revision(code)
    monkeypatch.delenv("GIT_DIR")
    assert first == {"revision": git(tmp_path, "rev-parse", "HEAD"), "modified": False}
    code.write_text("2\n")
    assert git_revision(code) == {**first, "modified": True}
