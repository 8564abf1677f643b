from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from skd_evaluator.cli.main import main
from skd_evaluator.metrics.clustered import DISTANCES, clustered_mean
from skd_evaluator.metrics.sample_size import expected_width, power, sizes_for_power, sizes_for_width


@given(st.floats(0.01, 1.0), st.floats(0.0, 0.2), st.integers(2, 30), st.integers(1, 50), st.booleans())
def test_power_is_that_of_the_noncentral_t(difference, between, safe, trials, paired):
    samples = 1 if paired else 2
    freedom = samples * (safe - 1)
    shift = difference / math.sqrt(samples * (between + 0.1 / trials) / safe)
    bound = stats.t.ppf(0.975, freedom)
    theirs = stats.nct.sf(bound, freedom, shift) + stats.nct.cdf(-bound, freedom, shift)
    if math.isfinite(theirs) and shift < 20.0:  # beyond, scipy's own is no number
        assert power(difference, between, 0.1, safe, trials, paired=paired) == pytest.approx(theirs, abs=2e-4)


def test_the_expected_width_is_the_mean_of_widths():
    rng = np.random.default_rng(0)
    trials, safe, trials = 1000, 5, 8
    means = rng.normal(0.0, 0.3, size=(trials, safe, 1))
    samples = means + rng.normal(0.0, 0.5, size=(trials, safe, trials))
    found = [clustered_mean(list(sample), prior=DISTANCES).interval for sample in samples]
    widths = np.array([high - low for low, high in found])
    expected = expected_width(0.09, 0.25, safe, trials, prior=DISTANCES)
    assert abs(widths.mean() - expected) < 4.0 * widths.std() / math.sqrt(trials)


def test_sizes_are_enough_and_one_phi_less_is_not():
    for size in sizes_for_width(0.1, 0.005, 0.17, prior=DISTANCES):
        assert size.width <= 0.1 < expected_width(0.005, 0.17, size.safe - 1, size.trials, prior=DISTANCES)
    for size in sizes_for_power(0.05, 0.8, 0.0005, 0.08, paired=True):
        assert size.power >= 0.8 > power(0.05, 0.0005, 0.08, size.safe - 1, size.trials, paired=True)
    assert sizes_for_width(1e-9, 1.0, 1.0) == []


def test_the_command_plans_from_stated_variances_and_refuses_what_is_not_enough(capsys):
    assert main(["plan", "--width", "0.1", "--kamikaze-count", "100", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    (size,) = found["sizes"]
    assert size["episodes"] == 100 * size["safe"]
    assert size["width"] <= 0.1
    assert "assumed" in found["source"]
    assert found["figure"] == "margin"
    assert main(["plan", "--width", "0.1", "--figure", "deviation"]) == 0
    assert capsys.readouterr().out.startswith("deviation: ")
    assert main(["plan", "--difference", "0.1", "--power", "0.9"]) == 0
    shown = capsys.readouterr().out
    assert "on the same φ" in shown
    assert main(["plan", "--width", "0.1", "--figure", "skd"]) == 2
    assert "--figure skd needs a result" in capsys.readouterr().err
    assert main(["plan", "--width", "1e-12"]) == 2
    assert "ask for a wider interval" in capsys.readouterr().err


def test_a_prior_is_left_out_where_it_can_say_nothing():
    """Of one trial on each φ, of values without variance, and of many φ; 10⁻³⁰⁰ m² had been a traceback."""
    for within, safe, trials, student in (
        (0.25, 60, 8, False), (0.25, 61, 8, True), (0.25, 5, 1, True), (0.25, 5, 2, False), (0.0, 5, 8, True),
        (1e-300, 5, 8, True),
    ):  # fmt: skip
        known = expected_width(0.09, within, safe, trials, prior=DISTANCES)
        plain = expected_width(0.09, within, safe, trials)
        assert (known == plain) == student
        assert known == pytest.approx(plain, rel=0.25)


def test_without_variance_a_difference_is_found_for_sure_or_by_chance_alone():
    assert power(0.1, 0.0, 0.0, 5, 5, paired=True) == 1.0
    assert power(-0.1, 0.0, 0.0, 2, 1, paired=False) == 1.0
    assert power(0.0, 0.0, 0.0, 5, 5, paired=True, level=0.07) == 0.07
    for paired, freedom in ((True, 4), (False, 8)):
        error = math.sqrt((1 if paired else 2) * 0.5 / 5)
        bound = stats.t.ppf(0.9, freedom)
        theirs = stats.nct.sf(bound, freedom, 1.0 / error) + stats.nct.cdf(-bound, freedom, 1.0 / error)
        assert power(1.0, 0.4, 0.2, 5, 2, paired=paired, level=0.2) == pytest.approx(theirs, abs=2e-4)
    assert power(0.0, 0.4, 0.2, 5, 2, paired=True) == pytest.approx(0.05, abs=1e-5)
