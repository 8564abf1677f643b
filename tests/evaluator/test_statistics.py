"""Means, intervals and differences over clusters, and how many trials a width takes: against closed forms and draws."""

import json
import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy import stats
from skd_evaluator.cli.main import main
from skd_evaluator.metrics.clustered import (
    DISTANCES,
    FREEDOM,
    Prior,
    VarianceComponents,
    cluster_error,
    clustered_mean,
    clustered_rate,
    variance_components,
)
from skd_evaluator.metrics.difference import Difference, difference
from skd_evaluator.metrics.sample_size import expected_width, power, sizes_for_power, sizes_for_width
from skd_evaluator.metrics.statistics import (
    frechet_probability_bound,
    jeffreys_interval,
    normal_interval,
    ratio_interval,
    wilson_interval,
)

NUMBERS = st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=50)


@given(st.integers(1, 500).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))), st.floats(0.5, 0.999))
def test_wilson_equals_scipy(counts, confidence):
    successes, trials = counts
    theirs = stats.binomtest(successes, trials).proportion_ci(confidence, method="wilson")
    assert wilson_interval(successes, trials, confidence) == pytest.approx(tuple(theirs), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("rate", [0.002, 0.016, 0.05, 0.3, 0.5])
def test_the_interval_of_a_rare_event_holds_its_rate_in_exact_enumeration(rate):
    """Wilson's holds 0.002 in 89 % of samples of 60: an event that was seen once moves it above."""
    counts = np.arange(61)
    ends = np.array([jeffreys_interval(count, 60) for count in counts.tolist()])
    holds = (ends[:, 0] <= rate) & (rate <= ends[:, 1])
    assert stats.binom.pmf(counts, 60, rate)[holds].sum() >= 0.92
    assert (ends[0, 0], ends[60, 1]) == (0.0, 1.0)
    exact = np.array([stats.binomtest(count, 60).proportion_ci(method="exact") for count in counts.tolist()])
    assert (ends[1:, 0] >= exact[1:, 0]).all()  # never wider than Clopper and Pearson's
    assert (ends[:-1, 1] <= exact[:-1, 1]).all()
    assert jeffreys_interval(0, 0) is None


@pytest.mark.parametrize("trials", [1, 3, 7, 100, 12345])
def test_wilson_at_the_ends_is_exact(trials):
    assert (wilson_interval(0, trials)[0], wilson_interval(trials, trials)[1]) == (0.0, 1.0)


@given(NUMBERS, st.floats(0.5, 0.999))
def test_normal_interval_equals_scipy(values, confidence):
    spread = stats.sem(values)
    if spread > 1e-9:
        theirs = stats.norm.interval(confidence, loc=np.mean(values), scale=spread)
        assert normal_interval(values, confidence) == pytest.approx(theirs, rel=1e-7, abs=1e-6)


@given(st.floats(0.01, 100.0), st.floats(0.0, 1000.0), st.floats(0.001, 0.999))
def test_bound_follows_the_papers_algebra(delta, variance, share):
    eta = share * delta
    paley_zygmund = 1.0 - (1.0 - eta / delta) ** 2 * delta**2 / (variance + delta**2)
    papers_last_line = paley_zygmund + eta**2 / (variance + delta**2)
    bound = frechet_probability_bound(eta, delta, variance)
    assert 0.0 <= bound <= 1.0
    assert bound == pytest.approx(min(1.0, papers_last_line), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(
    "distribution", [stats.gamma(4.0), stats.expon(), stats.uniform(0.0, 2.0), stats.lognorm(0.5), stats.bernoulli(0.7)]
)
def test_bound_holds_for_distributions_of_nonnegative_distances(distribution):
    sample = distribution.rvs(size=200_000, random_state=np.random.default_rng(2))
    delta = float(distribution.mean())
    for share in (0.01, 0.1, 0.3, 0.6, 0.9):
        eta = share * delta
        assert np.mean(sample <= eta) <= frechet_probability_bound(eta, delta, float(distribution.var()))


def test_ratio_interval_covers_the_ratio_of_the_means():
    rng = np.random.default_rng(0)
    covered = 0
    for _ in range(400):
        below = rng.uniform(0.5, 1.5, 60)
        low, high = ratio_interval(3.0 * below + rng.normal(0.0, 0.3, 60), below)
        covered += low <= 3.0 <= high
    assert 0.91 <= covered / 400 <= 0.98  # 95 % of 400 trials, give or take three standard errors


COUNTS = st.lists(st.integers(1, 40), min_size=2, max_size=8)
COMPONENTS = st.tuples(st.floats(0.0, 10.0), st.floats(0.01, 10.0))


@given(st.integers(2, 9), st.integers(1, 7), st.floats(0.5, 0.999), st.integers(0, 2**32))
def test_with_equal_groups_it_is_students_interval_over_their_means(groups, values, confidence, seed):
    sample = np.random.default_rng(seed).normal(size=(groups, values)) + 3.0
    found = clustered_mean(list(sample), confidence)
    means = sample.mean(axis=1)
    theirs = stats.t.interval(confidence, groups - 1, means.mean(), stats.sem(means))
    assert found.interval == pytest.approx(theirs, rel=1e-9)
    assert found.degrees_of_freedom == pytest.approx(groups - 1, rel=1e-9)
    assert found.value == pytest.approx(sample.mean())


def quadratic_form(counts, components):
    """Return the matrix of the squared error as a function of the means, found by asking for single and paired ones."""
    size = len(counts)

    def squared(means):
        return cluster_error(means, np.array(counts, float), components)[0] ** 2

    unit = np.eye(size)
    alone = [squared(unit[one]) for one in range(size)]
    return np.array(
        [
            [0.5 * (squared(unit[one] + unit[other]) - alone[one] - alone[other]) for other in range(size)]
            for one in range(size)
        ]
    ) + np.diag([alone[one] - 0.5 * (squared(2.0 * unit[one]) - 2.0 * alone[one]) for one in range(size)])


@given(COUNTS, COMPONENTS)
def test_the_squared_error_is_unbiased_and_has_satterthwaites_degrees_of_freedom(counts, variances):
    components = VarianceComponents(*variances)
    form = quadratic_form(counts, components)
    total = sum(counts)
    # Of independent values of variance 1 a group's mean has 1/n, and the mean of all 1/N.
    assert np.trace(form @ np.diag(1.0 / np.array(counts))) == pytest.approx(1.0 / total, rel=1e-9)
    roots = np.sqrt(variances[0] + variances[1] / np.array(counts))
    eigenvalues = np.linalg.eigvalsh(roots[:, None] * form * roots[None, :])
    _, freedom = cluster_error(np.arange(len(counts), dtype=float), np.array(counts, float), components)
    assert freedom == pytest.approx(eigenvalues.sum() ** 2 / (eigenvalues**2).sum(), rel=1e-6)


@given(st.lists(st.lists(st.floats(-10.0, 10.0), min_size=2, max_size=6), min_size=2, max_size=6))
def test_variance_components_are_those_of_the_analysis_of_variance(groups):
    everything = np.concatenate([np.asarray(group) for group in groups])
    inside = sum(((np.asarray(group) - np.mean(group)) ** 2).sum() for group in groups)
    assume(inside > 1e-6)
    found = variance_components(groups)
    within = inside / (len(everything) - len(groups))
    assert found.within == pytest.approx(within)
    sizes = np.array([len(group) for group in groups], float)
    typical = (sizes.sum() - (sizes**2).sum() / sizes.sum()) / (len(groups) - 1)
    ratio = stats.f_oneway(*groups).statistic
    assert found.between == pytest.approx(max(0.0, (ratio - 1.0) * within / typical), rel=1e-6, abs=1e-9)
    assert 0.0 <= found.correlation <= 1.0


def test_what_is_known_beforehand_stays_within_the_limits_and_moves_one_end():
    groups = [[1.0, 2.0], [2.0, 4.0], [5.0, 5.0]]
    up, down = (clustered_mean(groups, 0.9, prior=prior) for prior in (DISTANCES, DISTANCES.mirrored))
    below, above = DISTANCES.interval(np.array([1.5, 3.0, 5.0]), np.full(3, 2.0), 2.5, 0.9)
    assert up.interval == pytest.approx((up.value - below, up.value + above))
    assert above > below
    assert down.interval[0] < up.interval[0]
    assert down.interval[1] < up.interval[1]
    assert up.standard_error == clustered_mean(groups, 0.9).standard_error
    assert clustered_mean(groups, limits=(0.0, 4.0), prior=DISTANCES).interval[1] == 4.0
    alone = [[1.0], [2.0], [5.0]]  # nothing to measure the differences of φ by
    assert clustered_mean(alone, prior=DISTANCES).interval == clustered_mean(alone).interval


def test_what_is_degenerate_is_said():
    one = clustered_mean([[1.0, 2.0], []])
    assert (one.interval, one.standard_error, one.degrees_of_freedom) == (None, None, None)
    assert [note.split(":")[0] for note in one.notes] == ["one φ", "1 of 2 φ have nothing to count"]
    flat = clustered_mean([[1.0, 3.0]] * 6)
    assert flat.interval == (2.0, 2.0)
    assert "no width" in flat.notes[0]
    assert "2 φ" in clustered_mean([[1.0, 3.0], [2.0, 5.0]]).notes[0]
    lucky = clustered_mean([[0.0, 10.0], [0.1, 10.0], [0.0, 10.1], [0.1, 10.1], [0.0, 10.0]])
    assert "luck" in lucky.notes[0]
    assert clustered_mean([[1.0, 2.0], [4.0, 6.0], [1.5, 3.0], [2.0, 2.5], [0.0, 4.0]]).notes == ()
    assert clustered_mean([[], []]) is None
    assert clustered_mean([]) is None


@given(st.lists(st.integers(0, 30), min_size=2, max_size=8))
def test_the_ends_of_a_rate_are_where_wilsons_score_is_students_quantile(hits):
    counts = [(hit, 30) for hit in hits]
    found = clustered_rate(counts)
    low, high = found.interval
    assert 0.0 <= low <= found.value <= high <= 1.0
    assume(len(set(hits)) > 1)
    rates = np.array(hits) / 30
    squared = rates.var(ddof=1) / len(hits)
    effective = found.value * (1.0 - found.value) / squared
    for end in (low, high):
        score = abs(found.value - end) / math.sqrt(end * (1.0 - end) / effective)
        assert score == pytest.approx(stats.t.ppf(0.975, len(hits) - 1), rel=1e-6)


def test_rates_at_their_ends_and_degenerate_ones_are_said():
    none, every = clustered_rate([(0, 100)] * 5), clustered_rate([(100, 100)] * 5)
    assert none.interval[0] == 0.0
    assert every.interval == pytest.approx((1.0 - none.interval[1], 1.0))
    quantile = stats.t.ppf(0.975, 4)
    assert none.interval[1] == pytest.approx(quantile**2 / (500 + quantile**2))
    assert "none of 500" in none.notes[0]
    assert "all of 500" in every.notes[0]
    alike = clustered_rate([(5, 100)] * 5)
    assert 0.0 < alike.interval[0] < 0.05 < alike.interval[1]
    assert "same rate" in alike.notes[0]
    assert clustered_rate([(3, 10), (0, 0)]).interval is None
    assert clustered_rate([(0, 0)]) is None
    with pytest.raises(ValueError, match="hits must be"):
        clustered_rate([(4, 3)])


PLAIN = Prior(ratio=0.1, spread=1.0, skewness=0.0)


@pytest.mark.parametrize("counts", [(6, 6, 6), (3, 9, 4, 7)])
def test_it_is_the_posterior_of_the_one_way_layout(counts):
    """Over a grid of σ and ρ, each weighed by how likely it makes the values; the mean of all φ given both.

    The density of all values is that of scipy's multivariate normal.
    """
    rng = np.random.default_rng(4)
    sample = [rng.normal(centre, 1.0, size=count) for centre, count in zip((1.0, 2.2, 1.4, 0.7), counts, strict=False)]
    values = np.concatenate(sample)
    owner = np.repeat(np.arange(len(counts)), counts)
    same = (owner[:, None] == owner[None, :]).astype(float)
    ones = np.ones(len(values))
    shares, centres, deviations = [], [], []
    for ratio in np.exp(np.linspace(math.log(1e-3), math.log(1e3), 56)):
        for sigma in np.exp(np.linspace(-1.2, 1.4, 24)):
            covariance = sigma**2 * (np.eye(len(values)) + ratio * same)
            inverse = np.linalg.inv(covariance)
            precision = ones @ inverse @ ones
            centre = ones @ inverse @ values / precision
            density = stats.multivariate_normal(centre * ones, covariance).logpdf(values)
            prior = stats.t.logpdf(math.log(ratio / PLAIN.ratio) / PLAIN.spread, FREEDOM)
            shares.append(density - 0.5 * math.log(precision) + prior)  # the grid is even in ln ρ and in ln σ
            weights = np.array(counts) / len(values)
            centres.append(centre)
            deviations.append(sigma * math.sqrt(((ratio + 1.0 / np.array(counts)) * weights**2).sum()))
    shares = np.exp(np.array(shares) - max(shares))
    shares /= shares.sum()
    found = clustered_mean(sample, prior=PLAIN)
    half = found.interval[1] - found.value
    assert found.value - found.interval[0] == pytest.approx(half)
    # About the mean over all values, which is the posterior's own centre where all groups are of one size.
    held = shares @ (2.0 * stats.norm.cdf(half / np.array(deviations)) - 1.0)
    assert held == pytest.approx(0.95, abs=3e-3)
    if len(set(counts)) == 1:
        assert centres == pytest.approx([found.value] * len(centres))


SEEDS = st.integers(0, 2**32)


@given(st.integers(2, 8), st.integers(1, 6), st.floats(0.5, 0.999), SEEDS)
def test_paired_with_equal_groups_is_the_paired_t_test(groups, values, confidence, seed):
    rng = np.random.default_rng(seed)
    first, second = rng.normal(size=(2, groups, values))
    found = difference(list(first), list(second), paired=True, confidence=confidence)
    theirs = stats.ttest_rel(second.mean(axis=1), first.mean(axis=1))
    interval = theirs.confidence_interval(confidence)
    assert found.interval == pytest.approx((interval.low, interval.high), rel=1e-6)
    assert found.p_value == pytest.approx(theirs.pvalue, rel=1e-6)
    assert found.direction == (np.sign(found.value) if theirs.pvalue < 1.0 - confidence else 0)


@given(st.integers(2, 8), st.integers(2, 8), st.integers(1, 6), SEEDS)
def test_apart_with_equal_groups_is_welchs_test(ours, theirs, values, seed):
    rng = np.random.default_rng(seed)
    first, second = rng.normal(size=(ours, values)), 3.0 * rng.normal(size=(theirs, values))
    found = difference(list(first), list(second), paired=False)
    welch = stats.ttest_ind(second.mean(axis=1), first.mean(axis=1), equal_var=False)
    assert found.p_value == pytest.approx(welch.pvalue, rel=1e-6)
    assert found.degrees_of_freedom == pytest.approx(welch.df, rel=1e-6)


def test_effect_size_is_in_deviations_within_a_phi():
    first, second = [[0.0, 2.0], [10.0, 12.0]], [[1.0, 3.0], [11.0, 13.0]]
    found = difference(first, second, paired=True)
    assert found.value == pytest.approx(1.0)
    assert found.effect_size == pytest.approx(1.0 / np.sqrt(2.0))  # variance 2 within each φ
    assert found.interval == pytest.approx((1.0, 1.0))  # the same for every φ, which is said
    assert "no width" in found.notes[1]
    assert found.p_value == 0.0


@pytest.mark.parametrize(
    ("value", "error", "leaning"),
    [(1.1, 2.0, 1), (1.0, 2.0, 0), (-1.0, 2.0, 0), (-1.1, 2.0, -1), (0.1, None, 1), (-0.1, None, -1), (0.0, None, 0)],
)
def test_it_points_one_way_beyond_half_a_standard_error(value, error, leaning):
    found = Difference(value, (value - 4.0, value + 4.0), 0.95, 0.5, error, 5.0, None, paired=True)
    assert found.leaning == leaning
    assert found.direction == 0


def test_too_few_or_none():
    one = difference([[1.0, 2.0]], [[2.0, 4.0]], paired=True)
    assert (one.value, one.interval, one.p_value, one.direction) == (1.5, None, None, 0)
    assert difference([[1.0], [2.0]], [[2.0]], paired=False).interval is None
    assert difference([[]], [[1.0]], paired=True) is None
    with pytest.raises(ValueError, match="do not pair"):
        difference([[1.0], [2.0]], [[1.0]], paired=True)
    same = difference([[1.0], [2.0]], [[1.0], [2.0]], paired=True)
    assert (same.interval, same.p_value, same.direction) == ((0.0, 0.0), 1.0, 0)


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
    campaigns, safe, trials = 300, 5, 8
    means = rng.normal(0.0, 0.3, size=(campaigns, safe, 1))
    samples = means + rng.normal(0.0, 0.5, size=(campaigns, safe, trials))
    found = [clustered_mean(list(sample), prior=DISTANCES).interval for sample in samples]
    widths = np.array([high - low for low, high in found])
    expected = expected_width(0.09, 0.25, safe, trials, prior=DISTANCES)
    assert abs(widths.mean() - expected) < 4.0 * widths.std() / math.sqrt(campaigns)


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
    assert "basic car" in found["source"]
    assert found["figure"] == "margin"
    assert main(["compare", "--width", "0.1", "--figure", "deviation"]) == 0
    assert "Standard deviation of deviation: " in capsys.readouterr().out
    assert main(["compare", "--difference", "0.1", "--power", "0.9"]) == 0
    shown = capsys.readouterr().out
    assert "C = 1 and 1.05" in shown
    assert main(["compare", "--width", "0.1", "--figure", "skd"]) == 2
    assert "--figure skd needs a result" in capsys.readouterr().err
    assert main(["compare", "--width", "1e-12"]) == 2
    assert "ask for a wider interval" in capsys.readouterr().err
