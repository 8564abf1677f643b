"""Controllers: the basic one, and a user's, which loads or is wrong in one line."""

import fractions
import sys
from typing import Any

import numpy as np
import pytest
from common import refused
from skd_sim import AdversaryState, CarState, Controller, Scan, Scene, UsageError, load_scenario
from skd_sim.controllers.basic import PAPER_MULTIPLIERS, BasicController
from skd_sim.controllers.controller import make_controller, user_controller
from skd_sim.errors import AssessmentError, NoNumberError
from skd_sim.scenario.road import HEADING_NORTH

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


FILE = """
import helper
class Car:
    def reset(self, scenario, rng): pass
    def command(self, car, adversary): return helper.VALUE
class Short(Car):
    def command(self, car): return 0.0
class Reads(Car):
    def reset(self, scenario, rng): self.width = scenario.width
    def command(self, car, adversary): return adversary.distance
class Braking(Car): pass
class Takes(Car):
    def __init__(self, cfg): pass
class Parked:
    def reset(self, scenario, rng): pass
class Fails(Car):
    def __init__(self): raise RuntimeError("no model file")
constant = 3
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
    assert all(isinstance(one, Controller) for one in found)
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
        ("json:Nobody", r"controller json:Nobody: json has no Nobody"),
        ("car.py:Short", r"command must take \(car, adversary\), and takes \(car\) \(car.py, line 7\)$"),
        ("car.py:Takes", r"'cfg'; it is made without arguments \(car.py, line 13\)$"),
        ("car.py:Parked", r"controller car.py:Parked needs the method command\(car, adversary\)"),
        ("car.py:Fails", r"controller car.py:Fails.* RuntimeError: no model file"),
        ("car.py:constant", r"controller car.py:constant is an object of int; give a class"),
        ("car:Car", r"No module named 'car'; .*; did you mean car.py:Car\?$"),
        ("./car:Car", r"did you mean ./car.py:Car\?$"),
        ("absent:Car", r"No module named 'absent'; is it installed, or on PYTHONPATH\?$"),
        ("nothing.py:Car", "nothing.py: there is no such file"),
        ("nothing.py", "nothing.py: there is no such file"),
        ("./car.py", "controller car.py: name a class, as car.py:Class; it has .*Braking"),
        ("nowhere.at.all:Car", "controller nowhere.at.all:Car cannot be loaded: ModuleNotFoundError"),
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
    with pytest.raises(AssessmentError, match=r"no attribute 'distance'; it has x, y, .*heading \(car.py, line 10\)$"):
        controller.command(CarState(0, 0, HEADING_NORTH, 5), AdversaryState(0, 0, 0, 0))
    with pytest.raises(AssessmentError, match=r"no attribute 'width'; did you mean 'car.width'\? \(car.py, line 9\)$"):
        controller.reset(load_scenario("crossing"), np.random.default_rng())


CAR, ADVERSARY = CarState(0.0, -20.0, 1.5, 8.0), AdversaryState(0.0, 0.0, 0.0, 0.0)


class Answers:
    def __init__(self, answer: Any) -> None:
        self.answer = answer

    def reset(self, scenario: Any, rng: Any) -> None:
        pass

    def command(self, car: Any, adversary: Any) -> Any:
        if isinstance(self.answer, BaseException):
            raise self.answer
        return self.answer

    def commands(self, cars: Any, scenes: Any) -> Any:
        cars.speed[:] = 0.0  # of arrays that are its own
        return self.command(cars, scenes)


@pytest.mark.parametrize("answer", [-2.5, np.float32(-2.5), np.array(-2.5), fractions.Fraction(-5, 2)])
def test_a_number_of_any_kind_is_a_plain_one(answer: Any) -> None:
    found = user_controller(Answers(answer), "mine").command(CAR, ADVERSARY)
    assert (type(found), found) == (float, -2.5)


@pytest.mark.parametrize(
    ("answer", "shown"),
    [
        (None, "None"), (float("nan"), "nan"), (float("inf"), "inf"), (10**400, "1000"), ("1.0", "'1.0'"), (1j, "1j"),
        (True, "True"), (np.True_, "True"), (np.zeros(1), "array"), (np.ma.masked_all(1), "masked"),
        (b"5", "b'5'"),
    ],
)  # fmt: skip
def test_what_is_no_finite_number_is_said(answer: Any, shown: str) -> None:
    with pytest.raises(NoNumberError, match=r"controller mine: command must return a finite number .*; got") as caught:
        user_controller(Answers(answer), "mine").command(CAR, ADVERSARY)
    assert shown in str(caught.value)
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (ZeroDivisionError("by\nzero"), "ZeroDivisionError: by zero"),
        (SystemExit(0), "SystemExit: 0"),
        (KeyboardInterrupt(), "KeyboardInterrupt"),
    ],
)
def test_what_it_raises_is_said_with_the_line_of_its_code(error: BaseException, said: str) -> None:
    controller = user_controller(Answers(error), "mine")
    place = f"test_controllers.py, line {Answers.command.__code__.co_firstlineno + 2})"
    with refused(f"controller mine: command failed with {said}", place, error=AssessmentError):
        controller.command(CAR, ADVERSARY)


def test_it_senses_and_sees_the_scene_where_its_class_does() -> None:
    class Sees(Answers):
        def sense(self, scan: Scan) -> None:
            self.answer = float(scan.ranges[0])

        def command(self, car: CarState, scene: Scene) -> float:  # type: ignore[override]
            return float(self.answer)

    seeing, blind = user_controller(Sees(0.0), "mine"), user_controller(Answers(0.0), "mine")
    assert (seeing.takes_scene, seeing.takes_batches) == (True, False)
    assert (blind.takes_scene, blind.takes_batches, hasattr(blind, "sense")) == (False, True, False)
    seeing.sense(Scan(np.float32([3.0]), 0.0, 0.1, 10.0))  # type: ignore[attr-defined]
    assert seeing.command(CAR, ADVERSARY) == 3.0
