"""The margin's mean, interval and curve, and Cantelli's bound."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from report_support import make_sweep
from scipy import stats
from skd_evaluator.assessment.files.results import read_result
from skd_evaluator.metrics.deviation import Hit
from skd_evaluator.metrics.margins import Margins
from skd_evaluator.metrics.statistics import cantelli_bound, frechet_probability_bound, normal_interval
from skd_sim.world.state import Trajectory

MARGINS = st.lists(st.lists(st.floats(0.0, 5.0), min_size=1, max_size=12), min_size=2, max_size=8)


def margins(groups) -> Margins:
    """Return the margins of trials, m; infinity: nobody can be hit."""
    path = Trajectory(np.zeros((2, 2)), 0.3)
    hits = [[None if math.isinf(one) else Hit(one, path, 1.0, 5.0) for one in group] for group in groups]
    return Margins(tuple(map(tuple, hits)), 5.0)


def test_by_hand():
    found = margins([[0.0, 1.0, math.inf], [0.0, 2.0, 5.0]])
    assert (found.values.size, found.beyond) == (6, 1)
    assert found.mean == pytest.approx((0 + 1 + 5 + 0 + 2 + 5) / 6)
    assert found.curve is not None
    curve = found.curve.as_dict()
    assert found.curve.probability(0.0) == pytest.approx(2 / 6)
    assert curve["steps"]["eta"] == [0.0, 1.0, 2.0]
    np.testing.assert_allclose(curve["steps"]["probability"], [2 / 6, 3 / 6, 4 / 6])
    assert json.loads(json.dumps(curve, allow_nan=False))["area_above"] == found.curve.area_above


@given(MARGINS)
def test_the_area_above_the_curve_is_the_margin(groups):
    found = margins(groups)
    assert found.curve is not None
    curve = found.curve.as_dict()
    assert curve["area_above"] == pytest.approx(found.mean, abs=1e-9)
    values = np.concatenate([np.asarray(one) for one in groups])
    for point in curve["points"]:
        # Who is within a tenth of a nanometre of φ has followed it.
        assert point["probability"] == pytest.approx(np.mean(values <= max(point["eta"], 1e-10)))
        low, high = point["ci95"]
        assert 0.0 <= low <= point["probability"] <= high <= 1.0
        assert point["probability"] <= point["cantelli"] + 1.0 / len(values)  # of the sample's variance, by n − 1
        assert point["cantelli"] <= point["bound"] + 1e-12
    assert found.ci95 is not None
    assert 0.0 <= found.ci95[0] <= found.mean <= found.ci95[1] <= 5.0


def test_the_interval_is_by_phi_and_reaches_further_up():
    rng = np.random.default_rng(5)
    groups = [list(np.clip(rng.normal(one, 0.1, 25), 0.0, 5.0)) for one in rng.normal(1.0, 0.3, 10)]
    found = margins(groups)
    low, high = found.ci95 or (0.0, 0.0)
    means = [np.mean(one) for one in groups]
    student = stats.t.interval(0.95, 9, np.mean(means), stats.sem(means))
    trials = normal_interval(found.values)
    assert trials[1] - trials[0] < 0.5 * (high - low)  # 250 trials are not independent
    assert 0.7 < (high - low) / (student[1] - student[0]) < 1.5
    assert high - found.mean > found.mean - low


def test_nothing_to_say_is_said():
    assert margins([[1.0, 2.0]]).ci95 is None
    alike = margins([[5.0, math.inf], [math.inf, 5.0]])
    assert alike.mean == 5.0
    assert alike.curve is not None
    assert alike.curve.as_dict()["steps"] == {"eta": [], "probability": []}
    assert alike.clustered is not None
    assert any("same mean" in note for note in alike.clustered.notes)


@given(st.floats(0.01, 10.0), st.floats(0.0, 30.0), st.floats(1e-3, 0.999))
def test_cantelli_is_never_above_theorem_1(delta, variance, share):
    eta = share * delta
    assert cantelli_bound(eta, delta, variance) <= frechet_probability_bound(eta, delta, variance) + 1e-12


@given(st.floats(0.0, 3.0), st.floats(0.01, 3.0), st.floats(0.001, 0.999))
def test_a_law_of_two_points_attains_cantelli(eta, above, share):
    """Of η with probability p and η + a else: mean and variance are known, and P(d ≤ η) = p."""
    mean, variance = eta + above * (1.0 - share), above**2 * share * (1.0 - share)
    assert cantelli_bound(eta, mean, variance) == pytest.approx(share, rel=1e-6)


FIGURE = "margin_p10"


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    sweep = make_sweep(tmp_path_factory.mktemp("worst") / "sweep")
    return [sweep / "synthetic" / f"C_{multiplier}" for multiplier in ("0.5", "1")]


def figures_of(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "assessment.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("distances", "found"),
    [
        ([0.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0], 2.0),
        ([0.0, 0.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0], 0.0),
        ([1.0, 3.0], 1.2),
        ([0.7], 0.7),
        ([None, None, None], 5.0),
    ],
)
def test_it_is_the_tenth_between_order_statistics(distances, found):
    phi = Trajectory([[0.0, 0.0], [1.0, 0.0]], 0.3, "phi")
    ways = tuple(None if one is None else Hit(one, phi, 1.0, 4.0, 0.0) for one in distances)
    assert Margins((ways,), 5.0).quantile(0.1) == pytest.approx(found)


def test_a_tenth_of_the_trials_of_a_car_is_at_or_below_it(folders):
    for folder in folders:
        result = read_result(folder)
        margins = sorted(value for phi in result.groups["margin"] for value in phi.tolist())
        place = (len(margins) - 1) / 10
        low, high = margins[math.floor(place)], margins[math.ceil(place)]
        assert low <= result.figures[FIGURE] <= high
        assert result.figures[FIGURE] <= result.figures["margin"]
    assert figures_of(folders[0])[FIGURE] < figures_of(folders[1])[FIGURE]
