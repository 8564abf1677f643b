from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from skd_sim.controllers.basic import PAPER_MULTIPLIERS, BasicController
from skd_sim.controllers.loading import make_controller
from skd_sim.controllers.protocol import Controller
from skd_sim.errors import AssessmentError, UsageError
from skd_sim.scenario.road import HEADING_NORTH
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.state import AdversaryState, CarState

SCENARIO = load_scenario("crossing")
RNG = np.random.default_rng(0)


@pytest.mark.parametrize("multiplier", PAPER_MULTIPLIERS)
@pytest.mark.parametrize("x", [-3.5, 0.0, 50.0])
def test_basic_controller_measures_from_the_front_bumper_along_the_lane(multiplier: float, x: float) -> None:
    controller = BasicController(multiplier)
    controller.reset(SCENARIO, RNG)
    trigger = multiplier * (25.0 / 3.0) ** 2 / 7.0
    car = CarState(0.0, 0.0, HEADING_NORTH, 5.0)
    for distance, expected in [(1e-6, -3.5), (trigger - 1e-6, -3.5), (trigger + 1e-6, 0.0), (-1e-6, 0.0)]:
        assert controller.command(car, AdversaryState(x, SCENARIO.car.front + distance, 0.0, 0.0)) == expected


@pytest.mark.parametrize("name", ["", "fast", "module.Class", ":", "module:", ":Class"])
def test_unknown_controller(name: str) -> None:
    with pytest.raises(UsageError, match="unknown controller"):
        make_controller(name)


SOURCE = """
class Cautious:
    def reset(self, scenario, rng):
        self.scenario = scenario

    def command(self, car, adversary):
        return -1.25

class NoCommand:
    def reset(self, scenario, rng):
        pass

class NeedsArguments:
    def __init__(self, something):
        pass

class Fails:
    def __init__(self):
        raise RuntimeError("no model file")

constant = 3
"""


@pytest.fixture
def user_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    name = "skd_test_user_controller"
    (tmp_path / f"{name}.py").write_text(SOURCE, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, name, raising=False)
    return name


def test_user_controller(user_module: str) -> None:
    controller = make_controller(f"{user_module}:Cautious")
    assert isinstance(controller, Controller)
    controller.reset(SCENARIO, RNG)
    command = controller.command(CarState(0, 0, HEADING_NORTH, 5), AdversaryState(0, 0, 0, 0))
    assert command == -1.25


@pytest.mark.parametrize(
    ("class_name", "message"),
    [
        ("Absent", "has no Absent"),
        ("NoCommand", r"needs the method command\(car, adversary\)"),
        ("NeedsArguments", "TypeError"),
        ("Fails", "RuntimeError: no model file"),
        ("constant", "TypeError"),
    ],
)
def test_user_controller_that_does_not_load(user_module: str, class_name: str, message: str) -> None:
    with pytest.raises(UsageError, match=message) as caught:
        make_controller(f"{user_module}:{class_name}")
    assert f"{user_module}:{class_name}" in str(caught.value)


FILE = """
import helper
class Car:
    def reset(self, scenario, rng): pass
    def command(self, car, adversary): return helper.VALUE
class Short(Car):
    def command(self, car): return 0.0
class Reads(Car):
    def command(self, car, adversary): return adversary.distance
class Braking(Car): pass
"""


def test_a_class_of_a_file_is_found_by_its_path_and_two_files_of_one_name_are_two(tmp_path, monkeypatch) -> None:
    """Also where the folder is a package, and the path is relative or has a colon."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    found = []
    for folder, value in (("one", 1.0), ("two:2", 2.0)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "car.py").write_text(FILE.replace("helper.VALUE", str(value)))
        (tmp_path / folder / "helper.py").write_text("")
        found.append(make_controller(f"{tmp_path}/{folder}/car.py:Car"))
    state = (CarState(0, 0, HEADING_NORTH, 5), AdversaryState(0, 0, 0, 0))
    assert [one.command(*state) for one in found] == [1.0, 2.0]
    monkeypatch.chdir(tmp_path / "one")
    assert make_controller("./car.py:Car").command(*state) == make_controller("car.py:Car").command(*state) == 1.0
    (tmp_path / "package_of_cars").mkdir()
    (tmp_path / "package_of_cars" / "__init__.py").write_text("")
    (tmp_path / "package_of_cars" / "helper.py").write_text("VALUE = 3.0")
    (tmp_path / "package_of_cars" / "car.py").write_text(FILE.replace("import helper", "from . import helper"))
    assert make_controller("../package_of_cars/car.py:Car").command(*state) == 3.0


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("car.py:Brakin", r"controller car.py:Brakin: car.py has no Brakin; did you mean 'Braking'\?$"),
        ("car.py:Short", r"command must take \(car, adversary\), and takes \(car\) \(car.py, line 7\)$"),
        ("nothing.py:Car", "nothing.py: there is no such file"),
        ("syntax.py:Car", r"cannot be loaded: SyntaxError: .*syntax.py, line 1"),
        ("raises.py:Car", r"cannot be loaded: NameError: .*\(raises.py, line 2\)$"),
    ],
)
def test_a_file_that_is_wrong_is_named_with_its_line(tmp_path, monkeypatch, name, message) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.chdir(tmp_path)
    for file, text in (("car", FILE), ("helper", "VALUE = 0.0"), ("syntax", "class Car("), ("raises", "\nwrong")):
        (tmp_path / f"{file}.py").write_text(text)
    with pytest.raises(UsageError, match=message):
        make_controller(name)
    controller = make_controller("car.py:Reads")
    with pytest.raises(AssessmentError, match=r"no attribute 'distance'; it has x, y, .*heading \(car.py, line 9\)$"):
        controller.command(CarState(0, 0, HEADING_NORTH, 5), AdversaryState(0, 0, 0, 0))
