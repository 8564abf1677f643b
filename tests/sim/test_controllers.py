from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from skd_sim.controllers import (
    PAPER_MULTIPLIERS,
    BasicController,
    Controller,
    basic_acceleration,
    make_controller,
)
from skd_sim.errors import UsageError
from skd_sim.scenario.road import HEADING_NORTH
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.state import AdversaryState, CarState

SCENARIO = load_scenario("crossing")
RNG = np.random.default_rng(0)


def test_basic_law_includes_its_boundaries() -> None:
    trigger = 9.921
    for distance, expected in [
        (0.0, -3.5),
        (-0.0, -3.5),
        (trigger, -3.5),
        (math.nextafter(trigger, math.inf), 0.0),
        (math.nextafter(0.0, -1.0), 0.0),
        (5.0, -3.5),
        (100.0, 0.0),
    ]:
        assert basic_acceleration(distance, trigger, 3.5) == expected


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
        ("Absent", "AttributeError"),
        ("NoCommand", r"needs the methods reset\(scenario, rng\) and command\(car, adversary\)"),
        ("NeedsArguments", "TypeError"),
        ("Fails", "RuntimeError: no model file"),
        ("constant", "TypeError"),
    ],
)
def test_user_controller_that_does_not_load(user_module: str, class_name: str, message: str) -> None:
    with pytest.raises(UsageError, match=message) as caught:
        make_controller(f"{user_module}:{class_name}")
    assert f"{user_module}:{class_name}" in str(caught.value)
