"""The picture of a rating, and tables of many cars."""

import json
from dataclasses import replace

import pytest
from skd_evaluator.report.charts import (
    charted,
    coloured,
    comparison_charts,
    pareto,
    price_chart,
    priced_cars,
    rated_cars,
    rating_chart,
    vulnerability_chart,
)
from skd_evaluator.report.html.page import by_scenario, matrix_of, ranking_notes, render
from skd_evaluator.report.html.subjects import Subject, read_subjects


def test_cars_stand_where_their_results_say_and_a_line_joins_basic_ones(sweep):
    ((heading, cars),) = rated_cars(read_subjects([sweep])[::-1])
    assert heading == ""
    said = [json.loads(path.read_text()) for path in sorted(sweep.glob("synthetic/*/assessment.json"))]
    chart = rating_chart(cars, 2.0)
    line, points = chart["layer"][0]["data"]["values"], chart["layer"][-1]["data"]["values"]
    assert [row["C"] for row in line] == sorted(row["C"] for row in points) == [one["multiplier"] for one in said]
    assert [row["margin"] for row in line] == [one["margin"] for one in said]
    assert [row["value"] for row in line] == [one["risk_2"] for one in said]


def colours(chart: dict) -> dict[str, str]:
    scales = [one["encoding"]["color"]["scale"] for one in chart["layer"] if "color" in one["encoding"]]
    return dict(zip(scales[0]["domain"], scales[0]["range"], strict=True))


def test_the_pareto_line_joins_the_cars_that_no_cheaper_one_beats():
    cars = [(3.0, 4.0), (1.0, 0.5), (2.0, 0.5), (2.5, 9.0), (3.0, 5.0), (0.5, -0.2), (3.5, 6.0)]
    rows = [{"margin": margin, "y": price} for margin, price in cars]
    assert [(row["margin"], row["y"]) for row in pareto(rows)] == [(0.5, -0.2), (2.0, 0.5), (3.0, 4.0), (3.5, 6.0)]


def test_cars_that_do_not_get_past_stand_beside_the_line(sweep):
    ((_, cars),) = priced_cars(read_subjects([sweep]))
    runs = [{"kind": "waits", "passed": 30.0, "undisturbed": 6.0, "unslowed": 5.5, "braked": True}] * 60
    price = {"runs": runs, "aborted": 0}
    stuck = replace(cars[0], label="stuck", figures={**cars[0].figures, "price_of_caution": price, "margin": 4.9})
    layers = price_chart([*cars, stuck])["layer"]
    line, points, hollow = (layers[place]["data"]["values"] for place in (0, 3, 4))
    assert {row["car"] for row in line} <= {row["car"] for row in points}
    (row,) = [row for row in hollow if row["car"] == "stuck"]
    assert (row["y"], row["lost"], row["note"]) == (24.5, 24.0, "does not get past people")
    assert all(layer["data"]["values"] for layer in price_chart([stuck])["layer"])  # else Vega warns


def test_a_car_that_is_not_credible_is_hollow_and_not_ranked(sweep):
    first, second = read_subjects([sweep])
    figures = {**first.figures, "margin": 5.0, "warnings": ["not credible: it stands"]}
    cars = [first, second, replace(first, label="strange", figures=figures)]
    ranked, said = ranking_notes(cars)
    assert "strange" not in ranked
    assert said == "What is said of strange is not credible: its warnings say why."
    *_, points, hollow = (layer["data"]["values"] for layer in comparison_charts(cars)[0]["layer"])
    assert [[row["car"] for row in rows] for rows in (points, hollow)] == [[first.label, second.label], ["strange"]]


def test_many_cars_are_named_at_their_points(sweep):
    ((_, cars),) = priced_cars(read_subjects([sweep]))
    many = coloured([replace(cars[0], label=f"car {number}") for number in range(14)])
    labels = [layer for layer in price_chart(many)["layer"] if layer["mark"]["type"] == "text"]
    names = [row["car"] for layer in labels for row in layer["data"]["values"]]
    assert sorted(names) == sorted(one.label for one in many)


@pytest.mark.parametrize("turned", [False, True])
def test_a_car_has_one_colour_in_every_chart(sweep, turned):
    cars = read_subjects([sweep])[:: -1 if turned else 1]
    ((_, rated),), ((_, priced),) = rated_cars(cars), priced_cars(cars)
    charts = (rating_chart(rated, 1.0), price_chart(priced), vulnerability_chart(charted(cars)))
    found = [colours(one) for one in charts]
    assert all(one == found[0] for one in found)
    assert len(set(found[0].values())) == len(cars)
    many = coloured([charted(cars)[0]] * 20)
    assert len({one.colour for one in many}) == 20


@pytest.fixture(scope="module")
def subjects(sweep) -> list[Subject]:
    """Two cars in two scenarios: the second scenario is the first by another name."""
    here = read_subjects([sweep])
    scenario = replace(here[0].scenario, name="there")
    plans = [replace(one.assessment.plan, scenario=scenario) for one in here]
    there = [
        replace(one, label=f"{one.label} there", assessment=replace(one.assessment, plan=plan))
        for one, plan in zip(here, plans, strict=True)
    ]
    return [one for pair in zip(here, there, strict=True) for one in pair]


def test_each_assessment_is_in_the_cell_of_its_car_and_scenario(subjects):
    found = matrix_of(subjects)
    assert found["scenarios"] == ["crossing", "there"]
    for car, cells in found["rows"]:
        for name, several in zip(found["scenarios"], cells, strict=True):
            (mine,) = [one for one in subjects if one.figures["car"] == car and one.scenario.name == name]
            assert several == [mine.figures]
    assert [subjects[place].scenario.name for place in by_scenario(subjects)] == ["crossing"] * 2 + ["there"] * 2


def test_there_is_none_of_one_scenario_or_of_one_car(subjects):
    assert matrix_of(subjects[::2]) is None
    assert matrix_of(subjects[:2]) is None
    page = render(subjects)
    assert page.index('id="matrix"') < page.index('id="verdict-table"')
    for one in subjects:
        assert f">{one.figures['margin']:.3f}</strong><br><small>" in page[: page.index('id="verdict-table"')]
