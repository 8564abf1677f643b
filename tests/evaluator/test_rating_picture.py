"""Margin against risk: where cars stand, and that a car has one colour in every chart."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from cli_support import SMALL
from matplotlib.image import imread
from skd_evaluator.report.charts import charted, coloured, floor_of, rating_charts, vulnerability_chart
from skd_evaluator.report.html.subjects import read_subjects


@pytest.mark.parametrize(
    ("risks", "floor"),
    [((0.3, 0.02), 0.01), ((0.3, 0.01), 0.001), ((0.3, 2e-6), 1e-6), ((0.5,), 0.1), ((1e-14, 0.1), 1e-10)],
)
def test_the_axis_ends_at_a_power_of_ten_below_every_risk(risks, floor):
    assert floor_of([(one, 0.0, 0.0) for one in risks]) == pytest.approx(floor)


def test_cars_stand_where_their_results_say_and_a_line_joins_basic_ones(sweep):
    ((heading, charts),) = rating_charts(read_subjects([sweep])[::-1])
    assert heading == ""
    assert len(charts) == 3
    said = [json.loads(path.read_text()) for path in sorted(sweep.glob("synthetic/*/assessment.json"))]
    line, points = charts[1]["layer"][0]["data"]["values"], charts[1]["layer"][-1]["data"]["values"]
    assert [row["C"] for row in line] == sorted(row["C"] for row in points) == [one["multiplier"] for one in said]
    assert [row["margin"] for row in line] == [one["margin"] for one in said]
    assert [row["value"] for row in line] == [one["risk_2"] for one in said]


def colours(chart: dict) -> dict[str, str]:
    scales = [one["encoding"]["color"]["scale"] for one in chart["layer"] if "color" in one["encoding"]]
    return dict(zip(scales[0]["domain"], scales[0]["range"], strict=True))


@pytest.mark.parametrize("turned", [False, True])
def test_a_car_has_one_colour_in_every_chart(sweep, turned):
    cars = read_subjects([sweep])[:: -1 if turned else 1]
    ((_, ratings),) = rating_charts(cars)
    found = [colours(one) for one in (*ratings, vulnerability_chart(charted(cars)))]
    assert all(one == found[0] for one in found)
    assert len(set(found[0].values())) == len(cars)
    many = coloured([charted(cars)[0]] * 20)
    assert len({one.colour for one in many}) == 20


@pytest.mark.usefixtures("pictures_drawn")
def test_cars_of_one_scale_are_drawn_by_margin_and_risk(skd_here, here: Path, sweep):
    counts = [*SMALL, "--safe-count", "2", "--kamikaze-count", "14", "--collision-runs", "12"]
    assert skd_here("assess", *counts, "--behaviour", "walkers", "--seed", "9", "--out", "other").returncode == 0
    parts = [str(sweep / "synthetic" / f"C_{multiplier}") for multiplier in ("0.5", "1")]
    done = skd_here("compare", *parts, "--out", "both")
    assert done.returncode == 0, done.stderr
    assert imread(here / "both" / "rating.png").shape[1] > 600
    assert skd_here("compare", "other", parts[0], "--out", "unlike").returncode == 0
    assert not (here / "unlike" / "rating.png").exists()  # their φ differ
