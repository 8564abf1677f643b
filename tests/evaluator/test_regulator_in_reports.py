"""The regulator's grids in the report of a campaign: which cells, which colours, what stands out."""

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from common import assert_valid
from skd_evaluator.assessment.files.verification import verify
from skd_evaluator.assessment.stages.static_tests import place_of
from skd_evaluator.extensions.protocols.page import layout_of, reasons, views_of
from skd_evaluator.library import assess
from skd_evaluator.report.html.page import render
from skd_evaluator.report.html.subjects import Subject, read_subjects
from skd_sim.options.car_and_adversary import CarUnderTest
from skd_sim.scenario.scenario import Scenario, changed_scenario, load_scenario
from static_support import static_tests

KMH = 1.0 / 3.6


@pytest.fixture(scope="module")
def subject(tmp_path_factory) -> Subject:
    """A small assessment on three of the seven places of a protocol."""
    out = tmp_path_factory.mktemp("regulator") / "out"
    assess(scenario="cpna", multiplier=1.25, safe="regulatory", safe_count=3, objective="deviation", margin_limit=0,
           kamikaze_count=1, simulations=20, collision_runs=1, behaviour="none", workers=1, out=out)  # fmt: skip
    (found,) = read_subjects([out])
    return found


@dataclass(frozen=True)
class Found:
    """A result of one impact place, as the view wants it."""

    figures: dict[str, Any]
    scenario: Scenario
    margins: tuple[np.ndarray, ...]


def found(source: str, speed: float, place: float, *, touched: float = 0.0, margin: float = 1.0, **more: Any) -> Found:
    """Return a result at a test speed, km/h, whose car touches the target at a speed, km/h, if it does."""
    scenario = changed_scenario(source, {"car.start_speed": speed * KMH, "protocol.impact_places": [place], **more})
    test = {
        "place": place, "touched": touched > 0.0, "target": touched > 0.0, "impact_speed": touched * KMH,
        "speed_ahead": 0.0, "fastest": speed * KMH, "aborted": "",
    }  # fmt: skip
    figures = {
        "static_tests": [test], "per_safe_trajectory": [{"name": f"regulatory/{place:g}", "deviation": 2.0}],
        "car": "x:Y", "controller": "x:Y", "multiplier": 1.0, "eta_max": 5.0, "margin_converged": True,
        "margin_note": "", "seed": 0,
    }  # fmt: skip
    return Found(figures, scenario, (np.array([margin, margin]),))


def test_an_assessment_has_the_static_test_of_each_of_its_places(subject):
    tests = subject.figures["static_tests"]
    names = [str(row["name"]) for row in subject.figures["per_safe_trajectory"]]
    assert [one["place"] for one in tests] == [place_of(name) for name in names]
    by_hand = {one.place: one for one in static_tests(load_scenario("cpna"), CarUnderTest("basic", multiplier=1.25))}
    assert len(tests) == 3 < len(by_hand)
    for one in tests:
        assert one["touched"] == by_hand[one["place"]].touched
        assert one["impact_speed"] == by_hand[one["place"]].impact_speed
    assert_valid(dict(subject.figures))
    assert verify(subject.folder).fine


def test_the_page_has_the_grid_and_frames_what_is_narrow(subject):
    page = render([subject])
    assert '<section id="regulator"' in page
    assert "This is not an official rating." in page
    narrow = dataclasses.replace(subject)
    narrow.__dict__["margins"] = tuple(np.array([0.1]) for _ in subject.margins)
    shown = render([narrow])
    green = sum(cell.colour == "green" for cell in views_of([narrow])[0].grid.cells)
    assert shown.count('class="green narrow"') == green > 0
    figures = {key: value for key, value in subject.figures.items() if key != "static_tests"}
    assert '<section id="regulator"' not in render([dataclasses.replace(subject, figures=figures)])


def test_colours_are_those_of_the_matrix_at_each_speed():
    """2026: hit at 5 km/h it is brown at 30 km/h, orange at 40, yellow from 50 on, and red below 30."""
    hit = {20.0: "red", 30.0: "brown", 40.0: "orange", 50.0: "yellow", 60.0: "yellow"}
    (view,) = views_of([found("cpna", speed, 50.0, touched=5.0) for speed in reversed(hit)])
    assert [(cell.speed, cell.colour) for cell in view.grid.cells] == list(hit.items())
    assert [label for label, _ in layout_of(view.grid).rows] == ["20", "30", "40", "50", "60"]
    (passed,) = views_of([found("cpna", 30.0, place, margin=0.05) for place in (25.0, 75.0)])
    assert [(cell.colour, cell.is_narrow(0.5)) for cell in passed.grid.cells] == [("green", True)] * 2
    assert layout_of(passed.grid).columns == ("25 %", "75 %")


@pytest.mark.parametrize(
    ("result", "why"),
    [
        (found("cpna", 35.0, 50.0), "no test at 35 km/h"),
        (found("cpna", 30.0, 100.0), "no impact place of 100 %"),
        (found("cpna", 30.0, 50.0, **{"adversary.radius": 0.1}), "section adversary is not that of cpna"),
        (found("cpna", 30.0, 50.0, **{"protocol.speed": 2.0}), "section protocol is not that of cpna"),
        (found("cpna", 30.0, 50.0, **{"name": "mine"}), "none of the tests of 2026"),
    ],
)
def test_what_is_no_test_has_no_colour_and_says_why(result, why):
    (view,) = views_of([result])
    (cell,) = view.grid.cells
    assert cell.colour == ""
    assert why in cell.why
    assert cell.margin == 1.0
    assert any(why in line for line in reasons(view.grid))
