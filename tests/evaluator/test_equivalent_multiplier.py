"""The equivalent multiplier and the vulnerability curve."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.optimize import brentq, isotonic_regression
from skd_evaluator.metrics.margins import difference, equivalent_entries, equivalent_multiplier, isotonic_means
from skd_evaluator.metrics.statistics import wilson_interval
from skd_evaluator.metrics.vulnerability_curve import vulnerability_curve

GRID = [0.5, 0.75, 1.0, 1.25, 1.5]
FINE = np.linspace(0.5, 1.5, 101)


@given(st.lists(st.tuples(st.floats(-100.0, 100.0), st.integers(1, 500)), min_size=1, max_size=25))
def test_isotonic_means_equal_scipys(columns):
    means, counts = map(np.array, zip(*columns, strict=True))
    ours = isotonic_means((means * counts)[None], counts.astype(float)[None])[0]
    np.testing.assert_allclose(ours, isotonic_regression(means, weights=counts).x, rtol=1e-9, atol=1e-9)


def straight(multiplier: float) -> list[list[float]]:
    """Trials of two φ whose mean over both is the multiplier itself."""
    return [[multiplier - 0.2, multiplier + 0.2], [multiplier - 0.1, multiplier + 0.1]]


BASIC = {one: straight(one) for one in GRID}


@pytest.mark.parametrize("multiplier", [0.6, 0.75, 1.1, 1.4])
def test_without_chance_the_multiplier_is_read_off(multiplier):
    found = equivalent_multiplier(straight(multiplier), BASIC)
    assert found.value == pytest.approx(multiplier, abs=1e-12)
    # Both cars share all of their chance: nothing is left that another draw could change.
    assert found.ci95 == pytest.approx((multiplier, multiplier), abs=1e-12)
    assert found.ci95_trials == pytest.approx((multiplier, multiplier), abs=1e-12)


def test_the_interval_is_students_test_inverted():
    rng = np.random.default_rng(3)
    slope, phis = rng.uniform(0.5, 1.5, 8), rng.normal(0.0, 0.1, 8)
    basic = {one: [np.full(5, a * one) for a in slope] for one in FINE.tolist()}
    car = [np.full(5, a * 0.9 + b) for a, b in zip(slope, phis, strict=True)]
    found = equivalent_multiplier(car, basic)

    def p_value(multiplier: float) -> float:  # one mean a φ, all of one size: the plain t test over them
        return float(stats.ttest_1samp(slope * (0.9 - multiplier) + phis, 0.0).pvalue) - 0.05

    root = float((0.9 * slope + phis).mean() / slope.mean())
    assert found.value == pytest.approx(root, abs=1e-9)
    assert found.ci95 == pytest.approx((brentq(p_value, 0.5, root), brentq(p_value, root, 1.5)), abs=1e-4)


def test_beyond_what_was_compared_there_is_a_side_and_no_number():
    below = equivalent_multiplier([[0.1, 0.1], [0.1, 0.1]], BASIC)
    above = equivalent_multiplier([[5.0, 5.0], [5.0, 5.0]], BASIC)
    assert (below.text, above.text) == ("below 0.5", "above 1.5")
    assert equivalent_entries(above) == {
        "equivalent_multiplier": None,
        "equivalent_multiplier_text": "above 1.5",
        "equivalent_multiplier_ci95": [None, None],
        "equivalent_multiplier_ci95_these_phi": [None, None],
        "equivalent_multiplier_ci95_text": "[above 1.5, above 1.5]",
        "equivalent_multiplier_ci95_these_phi_text": "[above 1.5, above 1.5]",
    }
    assert set(equivalent_entries(None).values()) == {None}
    assert set(equivalent_entries(None)) == set(equivalent_entries(above))
    assert below.ci95 is not None
    assert below.interval_text(below.ci95) == "[below 0.5, below 0.5]"


def test_one_phi_has_no_interval_by_phi():
    found = equivalent_multiplier([[0.8, 0.9, 1.0]], {one: [[one, one + 0.1, one - 0.1]] for one in GRID})
    assert found.ci95 is None
    assert found.ci95_trials[0] < found.value < found.ci95_trials[1]


def test_trials_that_say_nothing_do_not_count():
    # The first φ has two trials that both cars have, the second one; the means are over all three.
    car, basic = [[0.6, math.nan, 1.0, 9.0], [0.7, 0.9]], [[0.5, 0.1, 0.5], [0.5]]
    found = difference(car, basic)
    assert found.trials == 3
    assert found.mean == pytest.approx((0.1 + 0.5 + 0.2) / 3)
    assert difference([[math.nan]], [[1.0]]) is None


ETA_MAX = 5.0
DEVIATIONS = st.one_of(st.floats(1e-6, 8.0), st.just(0.0), st.just(math.inf), st.sampled_from([0.5, 1.0, 5.0]))
GROUPS = st.lists(st.lists(DEVIATIONS, min_size=1, max_size=30), min_size=1, max_size=6)


@given(GROUPS)
def test_the_area_above_is_the_restricted_mean(groups):
    curve = vulnerability_curve(groups, ETA_MAX)
    restricted = [min(value, ETA_MAX) for group in groups for value in group]
    assert curve.area_above == pytest.approx(math.fsum(restricted) / len(restricted), abs=1e-9)


@given(GROUPS, st.one_of(st.just(0.0), st.floats(1e-6, ETA_MAX, exclude_max=True)))
def test_the_curve_is_the_empirical_distribution_and_the_bound_is_above_it(groups, eta):
    curve = vulnerability_curve(groups, ETA_MAX)
    values = np.concatenate(groups)
    assert curve.probability(eta).value == pytest.approx(np.mean(values <= (eta or 1e-10)))
    assert curve.probability(eta).plain_interval == wilson_interval(int(np.sum(values <= (eta or 1e-10))), len(values))
    assert curve.bound(eta) >= curve.probability(eta).value - 1e-12
    assert curve.bound(eta) >= curve.cantelli(eta) - 1e-12
    assert curve.cantelli(eta) >= curve.probability(eta).value - 1e-12
