"""Which files say what a car is: whatever it is read from counts, and what SKD itself writes does not."""

from __future__ import annotations

import hashlib
import os
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from skd_evaluator.campaign.plan import car_files as module
from skd_evaluator.campaign.plan.car_files import car_files
from skd_evaluator.campaign.plan.plan import Plan
from skd_evaluator.campaign.run.cluster_worker import _have, sent
from skd_evaluator.campaigns.folder import CELLS
from skd_evaluator.learning.kept_models import files_of, folder_of
from skd_evaluator.provenance import provenance
from skd_sim.choices.car_under_test import EXTERNAL, CarUnderTest
from skd_sim.choices.knowledge import Knowledge
from skd_sim.encounter.scenario import load_scenario
from skd_sim.errors import UsageError

CROSSING = load_scenario("crossing")


def put(path: Path, text: str = "1\n") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def cars(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A module of a user's in a folder of its own, which is looked for there."""
    folder = tmp_path / "cars"
    put(folder / "netcar.py", "raise SystemExit('nobody runs this')\n")
    monkeypatch.syspath_prepend(str(folder))
    return folder


def plan_of(controller: str) -> Plan:
    return Plan(CROSSING, controller=controller, knowledge=Knowledge.LEARNED)


def kept(controller: str = "netcar:Car", command: str | None = None) -> Path | None:
    return folder_of(plan_of(controller), command, None)


@pytest.mark.parametrize("name", ["weights.txt", "net.onnx", "nets/deep/weights.bin", "helpers/law.py", "no_ending"])
def test_whatever_lies_beside_a_module_is_part_of_the_car(cars: Path, name: str) -> None:
    found = [kept()]
    for text in ("30 8", "7 3"):
        put(cars / name, text)
        found.append(kept())
    assert None not in found
    assert len(set(found)) == 3
    put(cars / name, "30 8")
    assert kept() == found[1]


def test_a_net_behind_a_link_is_part_of_the_car(cars: Path, tmp_path: Path) -> None:
    put(tmp_path / "store" / "v7" / "weights.bin", "30 8")
    (cars / "net").symlink_to(tmp_path / "store" / "v7")
    before = kept()
    put(tmp_path / "store" / "v7" / "weights.bin", "7 3")
    assert kept() != before


@pytest.mark.parametrize(
    "name",
    [
        "__pycache__/netcar.cpython-311.pyc", ".git/HEAD", ".notes", "run.log", "skd_results/assess-1/assessment.json",
        "out/assessment.json", "campaign/cell/episodes.npz", "venv/lib/module.py", "written.csv",
    ],
)  # fmt: skip
def test_what_is_written_beside_a_module_makes_it_no_other_car(
    cars: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As an assessment whose results are put there, which would make the car another one each time."""
    monkeypatch.setattr(module, "_LEFT_OUT", set())
    module.leave_out([cars / "written.csv"])
    before = kept()
    put(cars / name, "2\n")
    for folder, marker in (("out", "manifest.sha256"), ("campaign", CELLS), ("venv", "pyvenv.cfg")):
        if name.startswith(folder):
            put(cars / folder / marker)
            put(cars / folder / ".lock")
    assert kept() == before is not None


def test_a_manifest_of_a_user_s_own_hides_no_weights(cars: Path) -> None:
    put(cars / "net" / "manifest.sha256")
    put(cars / "net" / "weights.bin", "30 8")
    before = kept()
    put(cars / "net" / "weights.bin", "7 3")
    assert kept() != before


def test_modules_from_elsewhere_count_with_what_lies_beside_them(
    cars: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However far the way is; what is installed, or Python's, does not."""
    for name in ("one", "two", "three"):
        monkeypatch.syspath_prepend(str(tmp_path / name))
    put(tmp_path / "one" / "helper.py", "def decide():\n    from laws.steep import law\n")
    put(tmp_path / "one" / "weights.txt")
    put(tmp_path / "two" / "laws" / "__init__.py", "")
    put(tmp_path / "two" / "laws" / "steep.py", "from . import inner\nfrom .inner import gain\n")
    put(tmp_path / "two" / "laws" / "inner.py", "import spread.gains\n")
    put(tmp_path / "two" / "laws" / "gains.bin")
    put(tmp_path / "two" / "beside_the_package.txt")
    put(tmp_path / "three" / "spread" / "gains.py", "")
    put(cars / "netcar.py", "import json, numpy, helper\nfrom skd_sim.state import CarState\n")
    files = car_files(CarUnderTest("netcar:Car"))
    assert files.why_not == ""
    assert {str(path.relative_to(tmp_path)) for path in files.all} == {
        "cars/netcar.py", "one/helper.py", "one/weights.txt", "two/laws/__init__.py", "two/laws/steep.py",
        "two/laws/inner.py", "two/laws/gains.bin", "three/spread/gains.py",
    }  # fmt: skip
    assert "two/laws/gains.bin".removeprefix("two/") in files.names
    assert "helper" not in sys.modules


def test_of_a_package_all_counts_and_of_an_installed_module_nothing_beside(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    package = tmp_path / "fleet"
    for name in ("__init__.py", "cars/fast.py", "cars/weights.bin", "nets/old.bin"):
        put(package / name, "")
    assert set(car_files(CarUnderTest("fleet.cars.fast:Car")).all) == {
        package / name for name in ("__init__.py", "cars/fast.py", "cars/weights.bin", "nets/old.bin")
    }
    installed = tmp_path / "site-packages"
    put(installed / "lonely.py", "import other\n")
    put(installed / "other.py")
    monkeypatch.syspath_prepend(str(installed))
    assert car_files(CarUnderTest("lonely:Car")).all == (installed / "lonely.py",)


def test_of_too_many_files_no_model_is_kept(cars: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_FILES", 5)
    for number in range(4):
        put(cars / f"{number}.bin")
    assert kept() is not None
    put(cars / "one_more.bin")
    assert kept() is None
    files = files_of(plan_of("netcar:Car"), None)
    assert files.all == (cars / "netcar.py",)
    assert files.why_not == f"more than 5 files lie in {cars}"
    monkeypatch.setattr(module, "MOST_FILES", 50)
    monkeypatch.setattr(module, "MOST_BYTES", 9)
    assert kept() is None


def test_sources_that_cannot_be_parsed_are_files_all_the_same(cars: Path) -> None:
    put(cars / "netcar.py", "def (:\n")
    assert kept() is not None
    os.mkfifo(cars / "pipe")
    (cars / "nowhere").symlink_to(cars / "gone")
    (cars / "circle").symlink_to(cars)
    assert car_files(CarUnderTest("netcar:Car")).all == (cars / "netcar.py",)


def test_a_stack_is_known_by_what_its_command_leads_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path / "src"))
    put(tmp_path / "stack" / "node.py", "import law\n")
    put(tmp_path / "stack" / "law.py", "")
    put(tmp_path / "stack" / "weights.bin", "30 8")
    put(tmp_path / "gains.yaml", "")
    put(tmp_path / "not_named.txt", "")
    put(tmp_path / "src" / "driver" / "__main__.py", "")
    put(tmp_path / "src" / "driver" / "__init__.py", "")
    put(tmp_path / "nets" / "v1" / "weights.bin", "30 8")

    def names(command: str) -> set[str]:
        files = car_files(CarUnderTest(EXTERNAL), command)
        return {str(one.relative_to(tmp_path)) for one in files.all if one.is_relative_to(tmp_path)}

    stack = {"stack/node.py", "stack/law.py", "stack/weights.bin"}
    assert names("python3 stack/node.py --ros-args") == stack
    assert names(f"{sys.executable} stack/node.py --params:=gains.yaml") == stack | {"gains.yaml"}
    assert names("python3 -m driver") == {"src/driver/__init__.py", "src/driver/__main__.py"}
    assert names("python3 stack/node.py --net nets/v1") == stack | {"nets/v1/weights.bin"}
    before = kept("external", "python3 stack/node.py")
    put(tmp_path / "stack" / "weights.bin", "7 3")
    assert kept("external", "python3 stack/node.py") != before is not None


@pytest.mark.parametrize("command", ["ros2 run pkg node", "python3 -m no_such_package", f"{sys.executable} -c 1", ""])
def test_no_model_is_kept_of_a_stack_of_which_no_file_is_known(command: str) -> None:
    assert kept("external", command) is None
    assert files_of(plan_of("external"), command).why_not


def test_a_result_names_the_files_and_has_one_digest_of_the_rest(cars: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    car = CarUnderTest("netcar:Car")
    put(cars / "weights.txt", "30 8")
    said = provenance(["skd"], car)["controller_files"]
    assert [one["path"] for one in said] == [str(cars / "netcar.py"), str(cars / "weights.txt")]
    assert said[1]["sha256"] == hashlib.sha256(b"30 8").hexdigest()
    monkeypatch.setattr(module, "LISTED", 2)
    rest = []
    for text in ("a", "b"):
        put(cars / "x.bin", text)
        put(cars / "y.bin")
        said = provenance(["skd"], car)["controller_files"]
        assert [one["path"] for one in said[2:]] == ["2 further files"]
        rest.append(said[2]["sha256"])
    assert rest[0] != rest[1]


def test_a_worker_with_another_file_of_the_car_is_refused(cars: Path) -> None:
    put(cars / "weights.txt", "30 8")
    controller = sent(CarUnderTest("netcar:Car"))
    _have(controller)
    put(cars / "weights.txt", "7 3")
    with pytest.raises(UsageError, match=r"has another .*weights\.txt"):
        _have(controller)
    (cars / "weights.txt").unlink()
    with pytest.raises(UsageError, match=r"does not have .*weights\.txt"):
        _have(controller)


def test_a_worker_with_another_file_of_the_package_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Wherever it is installed there."""
    for place in ("here", "there"):
        put(tmp_path / place / "fleet" / "__init__.py", "")
        put(tmp_path / place / "fleet" / "car.py", "from fleet import law\n")
        put(tmp_path / place / "fleet" / "law.py", "GAIN = 1\n")
    with monkeypatch.context() as patch:
        patch.syspath_prepend(str(tmp_path / "here"))
        controller = sent(CarUnderTest("fleet.car:Car"))
    monkeypatch.syspath_prepend(str(tmp_path / "there"))
    _have(controller)
    put(tmp_path / "there" / "fleet" / "law.py", "GAIN = 2\n")
    with pytest.raises(UsageError, match=r"has another .*law\.py"):
        _have(replace(controller))
