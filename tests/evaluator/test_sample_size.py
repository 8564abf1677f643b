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
    assert main(["compare", "--width", "0.1", "--kamikaze-count", "100", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    (size,) = found["sizes"]
    assert size["episodes"] == 100 * size["safe"]
    assert size["width"] <= 0.1
    assert "assumed" in found["source"]
    assert found["figure"] == "margin"
    assert main(["compare", "--width", "0.1", "--figure", "deviation"]) == 0
    assert capsys.readouterr().out.startswith("deviation: ")
    assert main(["compare", "--difference", "0.1", "--power", "0.9"]) == 0
    shown = capsys.readouterr().out
    assert "on the same φ" in shown
    assert main(["compare", "--width", "0.1", "--figure", "skd"]) == 2
    assert "--figure skd needs a result" in capsys.readouterr().err
    assert main(["compare", "--width", "1e-12"]) == 2
    assert "ask for a wider interval" in capsys.readouterr().err
