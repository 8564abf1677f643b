"""Which files say what a user's code is: another car is told from the one before, wherever it has changed."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.dask_cluster import _have, sent
from skd_evaluator.assessment.stages.car_model import model_file
from skd_evaluator.provenance import code_paths
from skd_sim.errors import UsageError
from skd_sim.options.adversary import AdversaryModel
from skd_sim.options.car_under_test import EXTERNAL, CarUnderTest
from skd_sim.scenario.scenario import load_scenario

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


def test_a_worker_with_another_package_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Wherever it is installed there."""
    for place in ("here", "there"):
        put(tmp_path / place / "convoy" / "__init__.py", "")
        put(tmp_path / place / "convoy" / "law.py", "GAIN = 1\n")
    with monkeypatch.context() as patch:
        patch.syspath_prepend(str(tmp_path / "here"))
        controller = sent(CarUnderTest("convoy.law:Car"))
    monkeypatch.syspath_prepend(str(tmp_path / "there"))
    _have(controller)
    put(tmp_path / "there" / "convoy" / "law.py", "GAIN = 2\n")
    with pytest.raises(UsageError, match="has other files of the controller"):
        _have(controller)
