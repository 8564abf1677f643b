"""Margin against risk: which cars stand where, and which basic cars may stand behind them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from cli_support import SMALL
from matplotlib.image import imread
from skd_evaluator.report.charts import RatedCar, basic_cars, floor_of, labelled, rated_car, rating_charts
from skd_evaluator.report.html.subjects import read_subjects


def car(margin: float, risk: float, *, multiplier: float | None = None, high: float = 0.0) -> RatedCar:
    return RatedCar(f"{margin}", multiplier, margin, (margin, margin), ((risk, (0.0, high)),) * 3)


@pytest.mark.parametrize(
    ("risks", "floor"),
    [((0.3, 0.02), 0.01), ((0.3, 0.01), 0.001), ((0.3, 2e-6), 1e-6), ((0.5,), 0.1), ((1e-14, 0.1), 1e-10)],
)
def test_the_axis_ends_at_a_power_of_ten_below_every_risk(risks, floor):
    assert floor_of([car(1.0, one) for one in risks], 0) == pytest.approx(floor)


def test_where_nobody_was_hit_the_axis_shows_how_much_there_may_be():
    assert floor_of([car(1.0, 0.3), car(2.0, 0.0, high=0.0015)], 1) == pytest.approx(1e-3)


def test_a_curve_goes_by_c_and_takes_two():
    low, high, other = car(1.0, 0.3, multiplier=0.5), car(2.0, 0.1, multiplier=1.5), car(3.0, 0.2)
    assert basic_cars([high, other, low]) == [low, high]
    assert basic_cars([other, low, low]) == []


def test_no_name_stands_on_another():
    curve = [
        car(margin, risk, multiplier=margin) for margin, risk in ((0.1, 0.5), (0.15, 0.49), (1.0, 0.1), (2.0, 0.02))
    ]
    assert labelled(curve, 0, 0.01) == ["0.1", "", "1", "2"]


def test_basic_cars_stand_in_the_report_as_their_results_say(sweep):
    """The folder of a sweep has two of them, over the same φ."""
    ((heading, charts),) = rating_charts(read_subjects([sweep]))
    assert heading == ""
    assert len(charts) == 3
    rows = charts[1]["data"]["values"]
    said = [json.loads(path.read_text()) for path in sorted(sweep.glob("synthetic/*/assessment.json"))]
    assert [row["C"] for row in rows] == [one["multiplier"] for one in said]
    assert [row["margin"] for row in rows] == [one["margin"] for one in said]
    assert [row["value"] for row in rows] == [one["risk_2"] for one in said]


def test_without_a_risk_there_is_no_place(sweep):
    (first, _) = read_subjects([sweep])
    assert rated_car(first.figures, "it") is not None
    assert rated_car({**first.figures, "risk_2": None}, "it") is None
    assert rated_car({**first.figures, "margin": None}, "it") is None


@pytest.mark.usefixtures("pictures_drawn")
def test_cars_of_one_scale_are_drawn_by_margin_and_risk(skd_here, here: Path):
    counts = [*SMALL, "--safe-count", "2", "--behaviour", "walkers"]
    assert skd_here("sweep", *counts, "--multipliers", "0.6", "1.2", "--out", "basics").returncode == 0
    for multiplier, seed in (("0.5", "0"), ("0.9", "0"), ("0.5", "9")):
        words = ("assess", *counts, "--multiplier", multiplier, "--seed", seed, "--out", f"{multiplier}_{seed}")
        assert skd_here(*words).returncode == 0
    parts = [f"basics/synthetic/C_{multiplier}" for multiplier in ("0.6", "1.2")]
    done = skd_here("compare", "0.5_0", "0.9_0", *parts, "--out", "both")
    assert done.returncode == 0, done.stderr
    assert imread(here / "both" / "rating.png").shape[1] > 600
    assert skd_here("compare", "0.5_9", "0.9_0", "--out", "other").returncode == 0
    assert not (here / "other" / "rating.png").exists()  # their φ differ
