"""Grids of `skd ncap` as they are stored, checked, and put into words."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from skd_evaluator.assessment.files.verification import Verified
from skd_evaluator.extensions.ncap.evaluation import requested_tests, scenario_of
from skd_evaluator.extensions.ncap.layout import layout_of, margin_text
from skd_evaluator.extensions.ncap.matrices import known_scenarios, matrix_of, scenarios_of
from skd_evaluator.extensions.ncap.result import RESULT, Grid, Ncap, NcapCell, as_data, read_ncap, with_regulator
from skd_sim.errors import UsageError
from skd_sim.options.car_under_test import CarUnderTest
from skd_sim.scenario.scenario import load_scenario
from skd_sim.scenario.scenario_file import SCENARIOS
from static_support import static_tests

KMH = 1.0 / 3.6
CELL = NcapCell(
    speed=30.0, target=5.0, place=50.0, range="standard", criterion="relative impact speed", touched=True,
    impact_speed=9.5, value=9.5, colour="brown", margin=0.5, margins=(0.25, 0.75),
)  # fmt: skip
GREEN = replace(CELL, touched=False, impact_speed=0.0, value=0.0, colour="green")


def of(*cells: NcapCell) -> Ncap:
    return Ncap(skd="0", car="a car", seed=0, trials=2, margin_limit=9, grids=(Grid("cpna", "x", cells),))


def store(folder, data: object) -> None:
    (folder / RESULT).write_text(json.dumps(data), encoding="utf-8")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, ""),
        ({"colour": "green"}, "a relative impact speed of 9.5 km/h is brown, not green"),
        ({"value": None}, "does not say of what"),
        ({"speed": 35.0}, "there are no colours at 35 km/h"),
        ({"margin": 0.4}, "not the mean"),  # between the least and the greatest
        ({"margins": (0.5,)}, "not the mean of 2 trials"),
        ({"margin": -1.0}, "must be a number from 0"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused(tmp_path, changes, said):
    found = of(replace(CELL, **changes))
    store(tmp_path, {**as_data(found), "provenance": {}})
    if said:
        with pytest.raises(UsageError, match=said):
            read_ncap(tmp_path)
        assert with_regulator(Verified(tmp_path, None)).problems
    else:
        assert read_ncap(tmp_path) == found


@pytest.mark.parametrize("data", [{**as_data(of(CELL)), "ncap": 2}, {}, [], {**as_data(of(CELL)), "more": 1}])
def test_a_file_of_another_version_or_kind_is_refused(tmp_path, data):
    store(tmp_path, data)
    with pytest.raises(UsageError, match=RESULT):
        read_ncap(tmp_path)


@pytest.mark.parametrize(
    ("cell", "narrow"),
    [
        (replace(GREEN, margin=0.5), False),
        (replace(GREEN, margin=0.49), True),
        (replace(GREEN, margin=None), False),
        (replace(CELL, margin=0.0), False),  # brown
        (replace(GREEN, criterion="speed reduction", value=25.0, impact_speed=20.0, margin=0.0), False),
    ],
)
def test_a_green_test_without_a_hit_is_narrow_below_the_room(cell, narrow):
    assert cell.is_narrow(0.5) == narrow


def test_a_margin_that_is_a_bound_says_so(tmp_path):
    """A search that has not converged may have missed a hit, so that it gives no least value."""
    lower, upper = replace(CELL, margin=3.0, margins=(1.0, 5.0), beyond=1), replace(CELL, converged=False)
    assert [margin_text(cell) for cell in (CELL, lower, upper, replace(upper, beyond=1))] == [
        "0.50", "≥3.00", "≤0.50", "≤0.50",
    ]  # fmt: skip
    store(tmp_path, as_data(of(CELL, lower, upper)))
    verified = with_regulator(Verified(tmp_path, None))
    assert not verified.problems
    assert [line.partition(":")[0] for line in verified.remarks[:2]] == [
        "1 of 3 margins are lower bounds", "1 of 3 margins are upper bounds",
    ]  # fmt: skip


def test_columns_are_places_or_the_speeds_of_targets():
    head_on = matrix_of("ccfhos")
    assert head_on is not None
    cells = tuple(NcapCell(speed=one.speed, target=one.target, place=one.place) for one in head_on.points)
    layout = layout_of(Grid("ccfhos", "", cells))
    assert layout.columns == ("25 %", "50 %", "75 %", "100 %")
    assert [label for label, _ in layout.rows][:4] == ["30 (50)", "40 (50)", "50 (50)", "60 (70)"]
    crossing = matrix_of("cccscp")
    assert crossing is not None
    cells = tuple(NcapCell(speed=one.speed, target=one.target, place=one.place) for one in crossing.points)
    layout = layout_of(Grid("cccscp", "", cells))
    assert layout.columns == tuple(f"{speed} km/h" for speed in range(20, 90, 10))
    assert [sum(cell is not None for cell in cells) for _, cells in layout.rows] == [7, 7, 5, 5, 5, 2, 2]


def test_every_test_of_the_matrices_can_be_had():
    """Each place and target speed that the calculator asks for stands in the scenario's own file, or is put there.

    An unbraked car runs into the target, or to be green would say nothing; of all 778 tests the command itself says so,
    with --multiplier 0.
    """
    assert set(known_scenarios()) == {name for name in SCENARIOS.own if load_scenario(name).protocol is not None}
    assert scenarios_of("CPTAfs & CPTAns") == ["cptafs", "cptans"]
    for name in known_scenarios():
        matrix, cells = requested_tests(name, None)
        assert matrix is not None
        assert cells == [NcapCell.of_point(point) for point in matrix.points]
        for cell in cells[-1:]:
            scenario = scenario_of(name, cell, matrix)
            assert scenario.protocol is not None
            assert scenario.protocol.speed == pytest.approx((cell.target or 0.0) * KMH)
            assert scenario.car.start_speed == pytest.approx(cell.speed * KMH)
            (one,) = static_tests(scenario, CarUnderTest("basic", 0.0))
            assert (one.touched, one.impact_speed) == (True, pytest.approx(cell.speed * KMH))
