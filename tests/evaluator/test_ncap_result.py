"""Grids of `skd ncap` as they are stored, checked, and put into words and pictures."""

from __future__ import annotations

import json

import pytest
from skd_evaluator.extensions.ncap.evaluation import requested_tests, scenario_of
from skd_evaluator.extensions.ncap.layout import headline, layout_of, margin_text, reasons
from skd_evaluator.extensions.ncap.matrices import Criterion, colour_of, known_scenarios, matrix_of, scenarios_of
from skd_evaluator.extensions.ncap.page import details
from skd_evaluator.extensions.ncap.result import RESULT, Grid, Ncap, NcapCell, as_data, ncap_of, read_ncap
from skd_sim.errors import UsageError
from skd_sim.options.car_under_test import CarUnderTest
from skd_sim.scenario.scenario import load_scenario
from skd_sim.scenario.scenario_file import SCENARIOS, lineage
from static_support import static_tests

KMH = 1.0 / 3.6


def small(**changes: object) -> Ncap:
    cell = NcapCell(
        speed=30.0, target=5.0, place=50.0, range="standard", criterion="relative impact speed", touched=True,
        impact_speed=9.5, value=9.5, colour="brown", margin=0.5, margins=(0.25, 0.75),
    )  # fmt: skip
    cells = (NcapCell(**{**vars(cell), **changes}),)
    return Ncap(skd="0", car="a car", seed=0, trials=2, margin_limit=9, room=0.5, grids=(Grid("cpna", "x", cells),))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, ""),
        ({"colour": "green"}, "a relative impact speed of 9.5 km/h is brown, not green"),
        ({"value": None}, "does not say of what"),
        ({"speed": 35.0}, "there are no colours at 35 km/h"),
        ({"margins": ()}, "no mean of those of its trials"),
        ({"margin": None}, "has no margin, which is no mean"),
        ({"margin": 0.4}, "has a margin of 0.4 m, which is no mean"),  # between the least and the greatest
        ({"margins": (0.5,)}, "has margins of 1 trials, and there were 2"),
        ({"colour": "blue"}, "must be one of"),
        ({"margin": -1.0}, "must be a number from 0"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused(tmp_path, changes, said):
    found = small(**changes)
    (tmp_path / RESULT).write_text(json.dumps({**as_data(found), "provenance": {}}), encoding="utf-8")
    if said:
        with pytest.raises(UsageError, match=said):
            read_ncap(tmp_path)
    else:
        assert read_ncap(tmp_path) == found


def test_a_file_of_another_version_or_kind_is_refused(tmp_path):
    for data in ({**as_data(small()), "ncap": 2}, {}, [], {**as_data(small()), "more": 1}):
        with pytest.raises(UsageError, match="there"):
            ncap_of(data, "there")
    with pytest.raises(UsageError, match=RESULT):
        read_ncap(tmp_path)


def test_a_green_test_with_as_much_room_as_wanted_is_not_narrow():
    green = {"colour": "green", "value": 0.0, "impact_speed": 0.0, "touched": False, "margins": (0.5,)}
    for margin, narrow in ((0.5, False), (0.49, True), (None, False)):
        (cell,) = small(**green, margin=margin).grids[0].cells
        assert cell.is_narrow(0.5) == narrow
    head_on = {"colour": "green", "criterion": "speed reduction", "value": 25.0, "margin": 0.0, "margins": (0.0,)}
    for changes in ({}, head_on):  # red, and green though it hits
        (cell,) = small(**changes).grids[0].cells
        assert not cell.is_narrow(9.0)
    assert margin_text(NcapCell(speed=1.0, margin=5.0, margins=(5.0, 5.0), beyond=2)) == "≥5.00"


def test_a_green_test_whose_margin_nobody_measured_says_so():
    """Where no trial has a hit, η_max stands for the margin, and the cell is not framed for that reason alone."""
    safe = {"colour": "green", "value": 0.0, "impact_speed": 0.0, "touched": False}
    (grid,) = small(**safe, margin=5.0, margins=(5.0, 5.0), beyond=2).grids
    assert headline(grid, 0.5).endswith("none with less than 0.5 m of room; of 1 because no hit was found.")
    line = "the search found no hit in any trial: the margin stands at η_max, and was not measured"
    assert reasons(grid) == [f"30 km/h, 50 %: {line}"]
    assert "no hit was found in 2 of 2 trials, which count as η_max" in details(grid.cells[0])
    (grid,) = small(**safe, margin=3.0, margins=(1.0, 5.0), beyond=1).grids
    assert headline(grid, 0.5).endswith("none with less than 0.5 m of room.")
    assert line not in " ".join(reasons(grid))
    assert "no hit was found in 1 of 2 trials" in details(grid.cells[0])


def test_a_trial_in_which_nobody_can_be_hit_is_not_hidden_in_a_mean():
    """Four hits and one trial without any are no margin of 1 m without a word."""
    (grid,) = small(margin=1.0, margins=(0.0, 0.0, 0.0, 0.0, 5.0), beyond=1).grids
    assert margin_text(grid.cells[0]) == "≥1.00"
    assert any("in some trials nobody could be hit within η_max" in line for line in reasons(grid))
    assert margin_text(NcapCell(speed=1.0, margin=1.0, margins=(0.0, 2.0), beyond=1, converged=False)) == "1.00"
    (grid,) = small(margin=0.5, margins=(0.5,), beyond=0).grids
    assert not any("nobody could be hit" in line for line in reasons(grid))


def test_what_is_said_of_a_grid():
    unsure = NcapCell(speed=30.0, place=50.0, colour="green", margin=2.0, margins=(2.0,), converged=False)
    refused = [
        NcapCell(speed=speed, place=50.0, why="it is too fast", margin_why="it is too fast") for speed in (70.0, 80.0)
    ]
    grid = Grid("cpna", "", (unsure, *refused))
    assert headline(grid, 0.5) == "1 of 1 test is green, none with less than 0.5 m of room."
    assert reasons(grid) == [
        "30 km/h, 50 %: the search for the margin has not converged, which is an upper bound: try a greater "
        "--margin-limit",
        "2 cells, from 70 km/h, 50 %: it is too fast",
    ]
    assert headline(Grid("cpna", "", tuple(refused)), 0.5) == "No test has a colour."
    assert headline(small(margin=None, margins=()).grids[0], 0.5) == "0 of 1 test is green."


def test_columns_are_places_or_the_speeds_of_targets():
    head_on = matrix_of("ccfhos")
    assert head_on is not None
    cells = tuple(NcapCell(speed=one.speed, target=one.target, place=one.place) for one in head_on.points)
    layout = layout_of(Grid("ccfhos", "", cells))
    assert layout.columns == ("25 %", "50 %", "75 %", "100 %")
    assert [row.label for row in layout.rows][:4] == ["30 (50)", "40 (50)", "50 (50)", "60 (70)"]
    crossing = matrix_of("cccscp")
    assert crossing is not None
    cells = tuple(NcapCell(speed=one.speed, target=one.target, place=one.place) for one in crossing.points)
    layout = layout_of(Grid("cccscp", "", cells))
    assert layout.columns == tuple(f"{speed} km/h" for speed in range(20, 90, 10))
    assert [sum(cell is not None for cell in row.cells) for row in layout.rows] == [7, 7, 5, 5, 5, 2, 2]


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
        assert [cell.point for cell in cells] == list(matrix.points)
        for cell in cells[-1:]:
            scenario = scenario_of(name, cell, matrix)
            assert scenario.protocol is not None
            assert scenario.protocol.speed == pytest.approx((cell.target or 0.0) * KMH)
            assert scenario.car.start_speed == pytest.approx(cell.speed * KMH)
            (one,) = static_tests(scenario, CarUnderTest("basic", 0.0))
            assert (one.touched, one.impact_speed) == (True, pytest.approx(cell.speed * KMH))


def test_a_file_belongs_to_the_matrix_of_what_it_builds_upon(tmp_path):
    (tmp_path / "one.yaml").write_text("name: one\nextends: cpfa-50\n")
    (tmp_path / "two.yaml").write_text("name: two\nextends: one.yaml\n")
    path = str(tmp_path / "two.yaml")
    assert lineage(path) == [path, str(tmp_path / "one.yaml"), "cpfa-50", "cpfa", "cpna", "crossing"]
    assert lineage("crossing") == ["crossing"]


@pytest.mark.parametrize(("speed", "colours"), [(20, "gr"), (30, "gbr"), (40, "gobr"), (50, "gyobr"), (60, "gyobr")])
def test_colours_change_every_ten_kmh_down_to_green(speed, colours):
    """What docs/ncap.md says of 2026: the faster the test, the more a lower impact speed is worth."""
    values = [0.0, *(10.0 * step + 5.0 for step in range(6))]
    found = [colour_of(Criterion.RELATIVE, float(speed), value)[0] for value in values]
    assert "".join(dict.fromkeys(found)) == colours
    assert colour_of(Criterion.IMPACT, float(speed), 0.1) == "red"
    assert [colour_of(Criterion.REDUCTION, 50.0, value) for value in (10.0, 20.0, 30.0, 30.1)] == [
        "red", "orange", "green", "red",
    ]  # fmt: skip
