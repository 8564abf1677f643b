from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.optimize import isotonic_regression
from skd_evaluator.measure.equivalent_multiplier import equivalent_entries, equivalent_multiplier, isotonic_means

GRID = [0.5, 0.75, 1.0, 1.25, 1.5]
DENSE = np.linspace(0.5, 1.5, 21)


@given(st.lists(st.tuples(st.floats(-100.0, 100.0), st.integers(1, 500)), min_size=1, max_size=25))
def test_isotonic_means_equal_scipys(columns):
    means, counts = map(np.array, zip(*columns, strict=True))
    ours = isotonic_means((means * counts)[None], counts.astype(float)[None])[0]
    np.testing.assert_allclose(ours, isotonic_regression(means, weights=counts).x, rtol=1e-9, atol=1e-9)


def straight(multiplier: float) -> list[list[float]]:
    """Attempts of two φ whose mean over both is the multiplier itself."""
    return [[multiplier - 0.2, multiplier + 0.2], [multiplier - 0.1, multiplier + 0.1]]


@pytest.mark.parametrize("multiplier", [0.5, 0.6, 0.75, 1.1, 1.5])
def test_without_chance_the_multiplier_is_read_off(multiplier):
    found = equivalent_multiplier(straight(multiplier), GRID, [straight(one) for one in GRID], paired=True)
    assert found.value == pytest.approx(multiplier, abs=1e-12)


def test_paired_chance_that_only_shifts_all_cars_alike_leaves_no_interval():
    found = equivalent_multiplier(straight(0.8), GRID, [straight(one) for one in GRID], paired=True)
    assert found.ci95 == pytest.approx((0.8, 0.8), abs=1e-9)
    apart = equivalent_multiplier(straight(0.8), GRID, [straight(one) for one in GRID], paired=False)
    assert apart.ci95[0] < 0.75 < 0.85 < apart.ci95[1]


def test_beyond_the_sweep_there_is_a_side_and_no_number():
    sweep = [straight(one) for one in GRID]
    below = equivalent_multiplier([[0.1, 0.1], [0.1, 0.1]], GRID, sweep, paired=True)
    above = equivalent_multiplier([[5.0, 5.0], [5.0, 5.0]], GRID, sweep, paired=True)
    assert (below.text, above.text) == ("below 0.5", "above 1.5")
    assert equivalent_entries(above) == {
        "equivalent_multiplier": None,
        "equivalent_multiplier_text": "above 1.5",
        "equivalent_multiplier_ci95_these_phi": [None, None],
        "equivalent_multiplier_ci95": [None, None],
        "equivalent_multiplier_ci95_these_phi_text": "[above 1.5, above 1.5]",
        "equivalent_multiplier_ci95_text": "[above 1.5, above 1.5]",
    }
    assert set(equivalent_entries(None).values()) == {None}
    assert below.interval_text(below.ci95) == "[below 0.5, below 0.5]"


def test_where_the_sweep_is_level_the_middle_counts():
    sweep = [[[value]] for value in (0.125, 0.5, 0.25, 0.375, 2.0)]  # pooled: 0.125, 0.375 thrice, 2
    assert equivalent_multiplier([[0.375]], GRID, sweep, paired=True).value == pytest.approx(1.0)
    assert equivalent_multiplier([[0.25]], GRID, sweep, paired=True).value == pytest.approx(0.625)


def test_attempts_that_say_nothing_do_not_count():
    with_gaps = equivalent_multiplier(
        [[0.6, math.nan, 1.0], [0.7, 0.9]], GRID, [straight(one) for one in GRID], paired=True
    )
    assert with_gaps.value == pytest.approx(0.8)


@pytest.mark.parametrize(
    ("car", "grid", "sweep"),
    [
        ([[1.0]], [1.0], [[[1.0]]]),
        ([[1.0]], [1.0, 0.5], [[[1.0]], [[1.0]]]),
        ([[1.0]], [0.5, 1.0], [[[1.0]]]),
        ([[1.0], [1.0]], [0.5, 1.0], [[[1.0]], [[1.0]]]),
        ([], [0.5, 1.0], [[], []]),
        ([[]], [0.5, 1.0], [[[1.0]], [[2.0]]]),
    ],
)
def test_what_cannot_be_compared_is_refused(car, grid, sweep):
    with pytest.raises(ValueError, match="sweep"):
        equivalent_multiplier(car, grid, sweep, paired=True)


def campaign(multipliers: list[float], shifts: np.ndarray, rng: np.random.Generator) -> list[list[np.ndarray]]:
    """Deformations as those of campaigns are: φ differ, chance within φ is partly common to all cars, some fail.

    The mean is a shape that was measured (floors of the basic car), with a factor of each φ.
    """
    level = np.interp(
        multipliers,
        [0.3, 0.5, 0.625, 0.75, 0.875, 1.0, 1.1, 1.15, 1.3, 1.5, 1.7],
        [0.04, 0.09, 0.17, 0.28, 0.49, 0.74, 0.94, 1.12, 1.98, 4.1, 4.8],
    )
    common = rng.normal(size=(len(shifts), 100))
    found = []
    for multiplier, mean in zip(multipliers, level, strict=True):
        own = rng.normal(size=common.shape)
        values = mean * shifts[:, None] + 0.3 * math.sqrt(mean) * (0.8 * common + 0.6 * own)
        values[rng.random(common.shape) < max(0.0, 0.3 * (multiplier - 1.0))] = 5.0
        found.append(list(np.clip(values, 0.0, 5.0)))
    return found


@pytest.mark.parametrize("paired", [True, False])
def test_intervals_hold_the_truth_as_often_as_they_say(paired):
    rng = np.random.default_rng(1)
    repetitions, held = 200, 0
    for repetition in range(repetitions):
        truth = rng.uniform(0.7, 1.3)
        shifts = rng.uniform(0.8, 1.2, 5)
        car, *sweep = campaign([truth, *DENSE], shifts, rng)
        if not paired:
            (car,) = campaign([truth], shifts, rng)
        found = equivalent_multiplier(car, DENSE, sweep, paired=paired, seed=repetition, resamples=300)
        held += found.ci95[0] <= truth <= found.ci95[1]
    # What 95 % give in 200 repetitions, at one in a thousand to either side.
    assert stats.binom.ppf(0.001, repetitions, 0.95) <= held <= stats.binom.ppf(0.999, repetitions, 0.95)
