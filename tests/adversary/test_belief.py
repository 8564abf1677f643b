from __future__ import annotations

import math

import numpy as np
import pytest
from models import ring
from skd_adversary.pomdp.belief import ParticleBelief

CELLS, FORWARD, STOP, SIGMA = 12, 0.7, 0.5, 1.5
SCRIPT = [(1, 3.2), (1, 4.9), (2, 6.1), (3, 9.4), (1, 10.2), (2, 0.3), (1, 1.4), (0, 1.0)]


def _exact(script: list[tuple[int, float]]) -> np.ndarray:
    """Bayes' filter on the ring, conditioned on the episode going on."""
    belief = np.full(CELLS, 1.0 / CELLS)
    for action, seen in script:
        moved = np.zeros(CELLS)
        for cell in range(CELLS):
            moved[(cell + action) % CELLS] += FORWARD * belief[cell]
            moved[cell] += (1.0 - FORWARD) * belief[cell]
        moved[0] *= 1.0 - STOP  # arriving there, or staying there, ends the episode with this probability
        belief = moved * np.exp(-0.5 * ((seen - np.arange(CELLS)) / SIGMA) ** 2)
        belief /= belief.sum()
    return belief


def _histogram(belief: ParticleBelief) -> np.ndarray:
    return np.bincount(belief.particles[:, 0].astype(int), weights=belief.weights, minlength=CELLS)


def test_a_particle_that_ends_the_episode_has_no_weight() -> None:
    belief = ParticleBelief(ring(stop=1.0), 1200, np.random.default_rng(6))
    belief.predict(0)  # cell 0 stops for sure
    ended = belief.particles[:, 0] == 0.0
    assert ended.any()
    assert (belief.weights[ended] == 0.0).all()
    belief.correct(0, np.array([0.0]))
    assert _histogram(belief)[0] == 0.0


@pytest.mark.parametrize("seen", [1e3, 1e9])
def test_depletion_redraws_and_counts(seen: float) -> None:
    """An observation that no particle explains: every likelihood is zero."""
    belief = ParticleBelief(ring(), 100, np.random.default_rng(7))
    belief.predict(1)
    belief.correct(1, np.array([seen]))
    assert (belief.particles[:, 0] == CELLS - 1).all()
    assert belief.depletions == 1
    np.testing.assert_array_equal(belief.weights, 0.01)


def test_particle_filter_against_the_exact_filter() -> None:
    """Independent runs: the spread between them gives the bound, and the bias must vanish within it."""
    runs, count = 40, 2000
    model = ring(cells=CELLS, forward=FORWARD, stop=STOP, sigma=SIGMA)
    histograms = np.empty((len(SCRIPT), runs, CELLS))
    means = np.empty((len(SCRIPT), runs))
    for run in range(runs):
        belief = ParticleBelief(model, count, np.random.default_rng([11, run]))
        for step, (action, seen) in enumerate(SCRIPT):
            belief.predict(action)
            belief.correct(action, np.array([seen]))
            assert belief.weights.sum() == pytest.approx(1.0)
            assert belief.depletions == 0
            histograms[step, run] = _histogram(belief)
            means[step, run] = belief.mean[0]
    for step in range(len(SCRIPT)):
        exact = _exact(SCRIPT[: step + 1])
        error = histograms[step].std(axis=0, ddof=1) / math.sqrt(runs)
        # 4.5 standard errors (t with 39 degrees of freedom: 6e-5), 12 cells, 8 lengths; a particle filter's own bias
        # is of the order 1/count.
        assert (np.abs(histograms[step].mean(axis=0) - exact) < 4.5 * error + 1.0 / count).all()
        mean_error = means[step].std(ddof=1) / math.sqrt(runs)
        assert abs(means[step].mean() - exact @ np.arange(CELLS)) < 4.5 * mean_error + CELLS / count
        # One run is as precise as √(1/n) promises, up to a factor for the noise that resampling adds.
        assert histograms[step].std(axis=0).max() < 4.0 * math.sqrt(0.25 / count)
