"""What a user's controller raises or answers is said in one line."""

from __future__ import annotations

import fractions
from typing import Any

import numpy as np
import pytest
from skd_sim.controllers.loading import user_controller
from skd_sim.errors import AssessmentError, NoNumberError
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.sensors import Scan
from skd_sim.world.state import AdversaryState, CarState, Scene

CROSSING = load_scenario("crossing")
CAR, ADVERSARY = CarState(0.0, -20.0, 1.5, 8.0), AdversaryState(0.0, 0.0, 0.0, 0.0)


class Answers:
    """Answers what it is made with, or raises it."""

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
    with pytest.raises(
        NoNumberError, match=r"controller mine: command must return a finite number \(m/s²\), got"
    ) as caught:
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
    with pytest.raises(AssessmentError) as caught:
        controller.command(CAR, ADVERSARY)
    line = Answers.command.__code__.co_firstlineno + 2
    assert f"controller mine: command failed with {said}" in str(caught.value)
    assert f"test_user_controller.py, line {line})" in str(caught.value)


def test_it_cannot_change_the_scenario_of_the_world() -> None:
    class Meddles(Answers):
        def reset(self, scenario: Any, rng: Any) -> None:
            object.__setattr__(scenario.car, "front", 0.1)
            scenario.road.line[...] += 5.0

    before = CROSSING.road.line.copy()
    with pytest.raises(AssessmentError, match=r"reset failed with ValueError: .*read-only"):
        user_controller(Meddles(0.0), "mine").reset(CROSSING, np.random.default_rng(0))
    np.testing.assert_array_equal(CROSSING.road.line, before)
    assert CROSSING.car.front != 0.1


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
