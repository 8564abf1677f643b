from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats
from skd_evaluator.metrics.clustered import clustered_mean
from skd_evaluator.metrics.sample_size import UntilWidth, narrow_enough, nominal_confidence


@pytest.mark.parametrize(
    ("looks", "bound"), [(1, 1.960), (2, 2.178), (3, 2.289), (4, 2.361), (5, 2.413), (8, 2.512), (10, 2.555)]
)
def test_the_bounds_are_pococks(looks, bound):
    """Jennison and Turnbull, Group Sequential Methods (2000), table 2.1, α = 0.05."""
    assert stats.norm.ppf(0.5 + nominal_confidence(looks) / 2.0) == pytest.approx(bound, abs=6e-4)


def test_all_looks_at_students_intervals_hold_together():
    """Batches of 5 φ with normal means: at every of 10 looks at once, for Student's t in the place of the normal."""
    rng = np.random.default_rng(2)
    trials, looks, batch = 20_000, 10, 5
    means = rng.normal(size=(trials, looks * batch))
    held = {confidence: np.ones(trials, bool) for confidence in (nominal_confidence(looks), 0.95)}
    for count in range(batch, looks * batch + 1, batch):
        seen = means[:, :count]
        score = np.abs(seen.mean(axis=1)) / (seen.std(axis=1, ddof=1) / math.sqrt(count))
        for confidence, every in held.items():
            every &= score <= stats.t.ppf(0.5 + confidence / 2.0, count - 1)
    repeated, naive = (every.mean() for every in held.values())
    assert repeated > 0.95 - 4.0 * math.sqrt(0.05 * 0.95 / trials)
    assert repeated < 0.965
    assert naive < 0.86


def test_an_interval_without_width_or_none_is_not_narrow():
    flat, one = clustered_mean([[1.0, 2.0]] * 3), clustered_mean([[1.0, 2.0]])
    wide = clustered_mean([[1.0], [2.0], [3.0]])
    width = wide.interval[1] - wide.interval[0]
    assert not narrow_enough(flat, 1.0)
    assert not narrow_enough(one, 1.0)
    assert narrow_enough(wide, width)
    assert narrow_enough(wide, 2.0 * width)
    assert not narrow_enough(wide, 0.999 * width)
    stopped = UntilWidth(1.0, 10, 0.99, ((1, one), (2, flat), (3, wide)))
    assert (stopped.reached, stopped.width) == (False, width)
    assert stopped.text.startswith("after 3 φ")
    assert "not 1 m as wanted" in stopped.text
    with pytest.raises(ValueError, match="at least one look"):
        nominal_confidence(0)
