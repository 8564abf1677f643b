from __future__ import annotations

import numpy as np
from belief import _STEPS, _measure
from scipy import stats
from skd_adversary.model.car.basic import unknown_car


def test_the_belief_finds_an_unknown_multiplier_and_is_as_sure_as_it_may_be() -> None:
    runs = 150
    result = _measure(unknown_car(), 400, runs)
    error, se = np.array(result["mean_absolute_error"]), np.array(result["mean_absolute_error_se"])
    assert abs(error[0] - 0.25 * 1.25) < 4.0 * se[0]  # nothing is known yet: mean |U − centre| of a uniform prior
    assert error[-1] < 0.5 * error[0]
    # Bonferroni over the steps, at 0.1 % in all.
    critical = stats.kstwo.isf(1e-3 / _STEPS, runs)
    assert max(result["kolmogorov_smirnov"]) < critical
