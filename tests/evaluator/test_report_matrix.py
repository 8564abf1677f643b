"""A report of several cars in several scenarios begins with a matrix of them."""

from __future__ import annotations

import dataclasses

import pytest
from skd_evaluator.report.charts import against_multiplier
from skd_evaluator.report.html.figures import by_scenario, matrix_of
from skd_evaluator.report.html.page import render
from skd_evaluator.report.html.subjects import Subject, read_subjects


@pytest.fixture(scope="module")
def subjects(sweep) -> list[Subject]:
    """Two cars in two scenarios: the second scenario is the first by another name."""
    here = read_subjects([sweep])
    scenario = dataclasses.replace(here[0].scenario, name="there")
    plans = [dataclasses.replace(one.assessment.plan, scenario=scenario) for one in here]
    there = [
        dataclasses.replace(one, label=f"{one.label} there", assessment=dataclasses.replace(one.assessment, plan=plan))
        for one, plan in zip(here, plans, strict=True)
    ]
    return [one for pair in zip(here, there, strict=True) for one in pair]


def test_each_assessment_is_in_the_cell_of_its_car_and_scenario(subjects):
    found = matrix_of(subjects)
    assert found["scenarios"] == ["crossing", "there"]
    for car, cells in found["rows"]:
        for name, several in zip(found["scenarios"], cells, strict=True):
            (mine,) = [one for one in subjects if one.figures["car"] == car and one.scenario.name == name]
            (cell,) = several
            assert cell["margin"] == f"{mine.figures['margin']:.3f}"
    assert [subjects[place].scenario.name for place in by_scenario(subjects)] == ["crossing"] * 2 + ["there"] * 2


def test_there_is_none_of_one_scenario_or_of_one_car(subjects):
    assert matrix_of(subjects[::2]) is None
    assert matrix_of(subjects[:2]) is None
    page = render(subjects)
    assert page.index('id="matrix"') < page.index('id="verdict-table"')


def test_no_line_joins_cars_of_one_multiplier(subjects):
    """As of one scenario at two speeds: there is no order in which to join them."""
    here = subjects[::2]
    assert against_multiplier(subjects)
    assert not against_multiplier([*here, dataclasses.replace(here[0], label="again")])
