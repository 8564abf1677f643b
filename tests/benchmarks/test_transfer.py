"""The benchmark of several worlds: its φ, worlds and table, and Kendall's τ of two of them."""

import argparse

import numpy as np
import pytest
import transfer
from cars.catalogue import CARS
from hypothesis import given
from hypothesis import strategies as st
from rank_agreement import kendall_tau
from scipy import stats

CARS_HERE = [car for car in CARS if car.label in ("basic, C = 0.75", "basic, C = 1.5")]


def test_cars_are_rated_in_a_world_once_and_stand_in_the_table(tmp_path, capsys):
    arguments = argparse.Namespace(
        out=tmp_path, safe_count=2, kamikaze_count=1, adversary_model="generic", margin_limit=64, seed=0, workers=1
    )
    worlds = [transfer.world("world")]
    table = transfer.rated(CARS_HERE, worlds, arguments)
    careless, careful = table["world"].values()
    assert careless.mean("margin") < careful.mean("margin")
    assert careless.multiplier.value <= 0.75 < 1.5 <= careful.multiplier.value
    alike = transfer.agreements({"one": table["world"], "other": table["world"]})
    assert alike["one", "other"]["margin"].tau == 1.0
    transfer.show(table, alike)
    assert "| basic, C = 1.5 |" in capsys.readouterr().out
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("assessment.json")}
    transfer.rated(CARS_HERE, worlds, arguments)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("assessment.json")} == before


few = st.integers(0, 6).map(float)  # few values, so that there are ties


@given(st.lists(st.tuples(few, few), min_size=2, max_size=12))
def test_tau_is_scipys(cars):
    first, second = np.array(cars).T
    expected = stats.kendalltau(first, second).statistic
    assert float(kendall_tau(first, second)) == pytest.approx(expected, nan_ok=True, abs=1e-12)


@given(st.lists(st.tuples(few, few, st.integers(0, 3)), min_size=2, max_size=8))
def test_a_car_that_counts_twice_is_two_cars_that_are_not_compared(cars):
    """So its weighted pairs are those of cars listed as often, less the pairs of a car with itself, which are ties."""
    first, second, often = np.array(cars).T
    listed = [np.repeat(row, often.astype(int)) for row in (first, second)]
    expected = float(kendall_tau(*listed)) if listed[0].size > 1 else float("nan")
    assert float(kendall_tau(first, second, often)) == pytest.approx(expected, nan_ok=True, abs=1e-12)
