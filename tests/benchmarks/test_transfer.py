"""The benchmark of several worlds: its φ, worlds and table, and Kendall's τ of two of them."""

from __future__ import annotations

import argparse
import json

import numpy as np
import pytest
import transfer
from cars.catalogue import CARS
from hypothesis import given
from hypothesis import strategies as st
from rank_agreement import agreement, kendall_tau
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
    json.dumps(transfer.as_dict(table, alike))
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


def world(means, phis=8, trials=4, spread=0.0, seed=0):
    rng = np.random.default_rng(seed)
    shift = spread * rng.standard_normal((len(means), phis, 1))
    return list(np.asarray(means)[:, None, None] + shift + 0.01 * rng.standard_normal((len(means), phis, trials)))


def test_the_interval_over_phi_holds_the_truth_as_often_as_it_says():
    """Six cars far apart but for two whose order in the second world is open: τ is 1 or 13/15, by chance of the φ."""
    means, held = [0.0, 1.0, 2.0, 3.0, 4.0, 4.05], 0
    for seed in range(40):
        found = agreement(world(means, 20, spread=0.1, seed=seed), world(means, 20, spread=0.1, seed=1000 + seed))
        held += found.by_phi[0] <= 1.0 <= found.by_phi[1]
    assert held >= stats.binom.ppf(1e-4, 40, 0.95)
