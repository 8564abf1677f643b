"""The planner and its belief."""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from models import ring, tiger
from problems.tiger import LISTEN, OPEN_LEFT, OPEN_RIGHT
from skd_adversary import ParticleBelief, Planner, PlannerOptions, Pomdp
from skd_adversary.pomdp.planner import Backup, Cells

GAMMA, ACCURACY = 0.95, 0.85
BELIEFS = np.linspace(0.0, 1.0, 4001)  # P(behind the right door)
Array = npt.NDArray[np.float64]


def _tiger_values(horizon: int, sigma: float | None = None) -> Array:
    """Optimal Q (actions × BELIEFS) by value iteration; `sigma`: Gaussian hearing, integrated on a grid."""
    if sigma is None:
        likelihoods = np.array([[ACCURACY, 1.0 - ACCURACY], [1.0 - ACCURACY, ACCURACY]])  # observation × state
    else:
        heard = np.linspace(-1.0 - 6.0 * sigma, 1.0 + 6.0 * sigma, 241)
        likelihoods = np.exp(-0.5 * ((heard[:, None] - np.array([-1.0, 1.0])) / sigma) ** 2)
        likelihoods /= likelihoods.sum(axis=0)
    prior = np.stack([1.0 - BELIEFS, BELIEFS])
    joint = likelihoods[:, :, None] * prior  # observation × state × belief
    chance = joint.sum(axis=1)
    posterior = joint[:, 1] / np.maximum(chance, 1e-300)
    best = np.zeros_like(BELIEFS)
    q = np.zeros((3, len(BELIEFS)))
    for _ in range(horizon):
        q[LISTEN] = -1.0 + GAMMA * (chance * np.interp(posterior, BELIEFS, best)).sum(axis=0)
        start = np.interp(0.5, BELIEFS, best)
        q[OPEN_LEFT] = 10.0 * BELIEFS - 100.0 * (1.0 - BELIEFS) + GAMMA * start
        q[OPEN_RIGHT] = 10.0 * (1.0 - BELIEFS) - 100.0 * BELIEFS + GAMMA * start
        best = q.max(axis=0)
    return q


def _planner(model: Pomdp, p_right: float, options: PlannerOptions, seed: int) -> tuple[Planner, ParticleBelief]:
    rng = np.random.default_rng([17, seed])
    belief = ParticleBelief(model, options.particles, rng)
    belief.particles[:, 0] = np.arange(options.particles) >= options.particles // 2
    belief.weights[:] = np.where(belief.particles[:, 0] == 1.0, p_right, 1.0 - p_right)
    belief.weights /= belief.weights.sum()
    return Planner(model, options, rng), belief


def _shares(model: Pomdp, p_right: float, options: PlannerOptions, runs: int) -> Array:
    actions = []
    for seed in range(runs):
        planner, belief = _planner(model, p_right, options, seed)
        actions.append(planner.plan(belief))
    return np.bincount(actions, minlength=3) / runs


@pytest.mark.parametrize("horizon", [1, 2, 3])
def test_root_value_is_the_optimum_of_a_short_horizon(horizon: int) -> None:
    """Discrete observations counted twice would give +5.3 at horizon 2 instead of −1.95."""
    options = PlannerOptions(simulations=20_000, depth=horizon, exploration=50.0)
    runs = 10
    values = np.empty(runs)
    for seed in range(runs):
        planner, belief = _planner(tiger(), 0.5, options, seed)
        assert planner.plan(belief) == LISTEN
        values[seed] = planner.values[LISTEN]
    optimum = _tiger_values(horizon)[LISTEN, 2000]
    error = values.std(ddof=1) / math.sqrt(runs)
    # Above the optimum by chance, and by what the best of noisy means is too high while a node is young: well under
    # the cost of one step of listening. Below it by what exploring costs: UCB1 pulls an arm that is Δ worse
    # c²·ln N / Δ² times. In the 2 + 4 nodes below the root, of N ≤ 10⁴ visits, Δ ≥ 5.5 for one door and
    # Δ ≥ 40 for the other.
    nodes = sum(2**level for level in range(1, horizon))
    regret = nodes * 50.0**2 * math.log(1e4) * (1.0 / 5.5 + 1.0 / 40.0) / 20_000
    assert optimum - regret - 4.0 * error - 1e-9 <= values.mean() <= optimum + 4.0 * error + 0.25


# c: the range of the rewards. Over so long a horizon a mean over all tries contains too many opened doors.
OPTIONS = PlannerOptions(simulations=4000, depth=25, exploration=110.0, backup=Backup.BEST, cells=Cells.NEAREST)


@pytest.mark.parametrize("count", [-4, -1, 0, 1, 4])
def test_action_after_each_observation_count_is_the_optimal_one(count: int) -> None:
    optimal = OPEN_LEFT if count >= 2 else OPEN_RIGHT if count <= -2 else LISTEN
    runs = 20
    # how probable the tiger is on the side where it was heard so much oftener than on the other
    p_right = 1.0 / (1.0 + ((1.0 - ACCURACY) / ACCURACY) ** count)
    share = _shares(tiger(), p_right, OPTIONS, runs)[optimal]
    # Optimal more often than not, at the 0.1 % level (binomial).
    assert share >= 0.5 + 3.1 * math.sqrt(0.25 / runs)


@pytest.mark.parametrize("p_right", [0.5, 0.85])
def test_it_gathers_information_from_continuous_observations(p_right: float) -> None:
    """QMDP takes the state for known after one step: with it no belief is worth listening at a cost twice."""
    sigma = 1.0
    q = _tiger_values(200, sigma)
    optimal = int(np.argmax([np.interp(p_right, BELIEFS, row) for row in q]))
    assert optimal == LISTEN
    model = tiger(gaussian=True)
    for options in (OPTIONS, replace(OPTIONS, backup=Backup.MEAN, cells=Cells.LIKELIHOOD)):
        assert _shares(model, p_right, options, 20)[LISTEN] >= 0.85


@pytest.mark.parametrize("backup", list(Backup))
def test_the_subtree_of_what_was_done_and_heard_is_kept(backup: Backup) -> None:
    """Visits below the child are those of the child: the search goes on from there."""
    options = PlannerOptions(simulations=500, depth=6, exploration=50.0, backup=backup, keep_tree=True)
    planner, belief = _planner(tiger(), 0.5, options, 3)
    planner.plan(belief)
    listened = planner.visits[LISTEN]
    planner.advance(LISTEN, np.array([1.0]))
    kept = planner.visits.sum()
    assert 0 < kept < listened
    belief.predict(LISTEN)
    belief.correct(LISTEN, np.array([1.0]))
    planner.plan(belief)
    assert planner.visits.sum() == kept + 500


def test_a_certain_catastrophe_is_not_tried_over_and_over() -> None:
    """It is known after a single try; the range of the returns as constant would try that door 7 times in 1,000."""
    model = tiger(wrong=-1000.0)
    rng = np.random.default_rng(5)
    planner, belief = Planner(model, PlannerOptions(simulations=1000, depth=1), rng), ParticleBelief(model, 400, rng)
    belief.particles[:, 0] = 1.0
    assert planner.plan(belief) == OPEN_LEFT
    assert planner.visits[OPEN_RIGHT] == 1


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
