"""What skd fuse computes and plans, against closed forms and draws."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from common import run_skd
from scipy import stats
from skd_evaluator.extensions.fusion import estimate
from skd_evaluator.extensions.fusion.estimate import alone
from skd_evaluator.extensions.fusion.fusion import fuse, fused_figure, gap_of, trend
from skd_evaluator.extensions.fusion.trials import FIGURES, Pairs, PhysicalTrial, paired
from skd_evaluator.metrics.sample_size import nominal_confidence
from skd_sim.errors import UsageError


def drawn(rng: np.random.Generator, rho: float, pairs: int, simulated: int = 2000) -> tuple[np.ndarray, ...]:
    x, other = rng.standard_normal((2, simulated))
    y = rho * x + math.sqrt(1.0 - rho**2) * other
    return y[:pairs], x[:pairs], x


def test_the_fused_mean_is_the_line_at_the_mean_of_all():
    y, x, every = drawn(np.random.default_rng(1), 0.8, 12)
    line, by_scipy = estimate.fitted_line(y, x), stats.linregress(x, y, alternative="greater")
    assert line.slope == pytest.approx(by_scipy.slope)
    assert line.correlation == pytest.approx(by_scipy.rvalue)
    assert line.p_value == pytest.approx(by_scipy.pvalue)
    found = estimate.fused(y, x, every, line)
    assert found.value == pytest.approx(by_scipy.intercept + by_scipy.slope * every.mean())
    # The error of a line at a place (any textbook), and of the place itself.
    at = by_scipy.intercept_stderr**2 + (by_scipy.stderr * every.mean()) ** 2
    at += 2.0 * every.mean() * (-x.mean() * by_scipy.stderr**2)
    expected = math.sqrt(at + line.slope**2 * every.var(ddof=1) / every.size)
    assert found.error == pytest.approx(expected)
    assert estimate.skewness(y - y.mean()) == pytest.approx(stats.skew(y, bias=False))


def test_symmetric_figures_have_student_s_interval():
    y = np.array([-3.0, -1.0, -0.5, 0.5, 1.0, 3.0])
    low, high = stats.t.interval(0.95, 5, 0.0, stats.sem(y))
    assert alone(y).interval == pytest.approx((low, high))
    skewed = np.append(y[:-1], 9.0)
    reach = stats.t.ppf(0.975, 5) * stats.sem(skewed)
    below, above = alone(skewed).interval
    assert below == pytest.approx(skewed.mean() - reach)
    assert above > skewed.mean() + 1.05 * reach


@pytest.mark.parametrize(
    ("rho", "pairs", "narrower"),
    [(0.8, 10, 1.5), (0.8, 20, 1.5), (0.9, 20, 2.1), (0.0, 10, 1 / 1.1), (0.0, 20, 1 / 1.04)],
)
def test_intervals_hold_and_are_narrower(rho, pairs, narrower):
    rng = np.random.default_rng(pairs)
    held, widths = 0, []
    for _ in range(600):
        y, x, every = drawn(rng, rho, pairs)
        both = estimate.fused(y, x, every, estimate.fitted_line(y, x))
        held += both.interval[0] <= 0.0 <= both.interval[1]
        widths.append((alone(y).width, both.width))
    assert 0.93 <= held / 600 <= 0.98  # 3.5 standard errors about 95.5 %
    first, second = np.mean(widths, axis=0)
    assert first / second >= narrower


def test_saved_trials_are_those_that_an_interval_as_narrow_takes():
    for pairs, narrower in ((10, 0.5), (20, 0.62), (40, 0.9)):
        saved = estimate.trials_saved(pairs, narrower, 0.95)
        counts = np.array([pairs, pairs + saved - 1, pairs + saved])
        width = stats.t.ppf(0.975, counts - 1) / np.sqrt(counts)
        assert width[2] <= narrower * width[0] < width[1]
    assert estimate.trials_saved(10, 1.1, 0.95) == 0


def test_rates_hold_and_stay_rates():
    rng = np.random.default_rng(3)
    held, widths, used = 0, [], 0
    limit = stats.norm.ppf(0.3)
    for _ in range(400):
        hard = rng.standard_normal(1000)
        hits = (0.95 * hard + 0.31 * rng.standard_normal(1000) < limit)[:20].astype(float)
        x = stats.norm.cdf((limit - hard) / 0.3)
        groups = [hits[index : index + 1] for index in range(20)]
        if not 3 <= hits.sum() <= 17:
            continue
        used += 1
        found = estimate.fused_rate(hits, x[:20], x, estimate.fitted_line(hits, x[:20]))
        assert 0.0 <= found.interval[0] <= found.value <= found.interval[1] <= 1.0
        held += found.interval[0] <= 0.3 <= found.interval[1]
        widths.append((estimate.alone_rate(groups).width, found.width))
    first, second = np.mean(widths, axis=0)
    assert used > 300
    assert held / used >= 0.94
    assert first / second > 1.4


def hits_of(*groups: tuple[int, int]) -> list[np.ndarray]:
    return [np.array([1.0] * hits + [0.0] * (trials - hits)) for hits, trials in groups]


def score_ends(rate: float, error: float, most: float, quantile: float) -> list[float]:
    """The rates p with (rate − p)² = quantile² p (1 − p) / effective."""
    share = quantile**2 / min(rate * (1.0 - rate) / error**2, most)
    return sorted(np.roots([1.0 + share, -2.0 * rate - share, rate**2]).real)


def test_a_nominal_collision_rate_counts_phi_alike():
    """The mean of the φ's rates and its error, by scipy; the interval by the quadratic equation that it solves."""
    groups = hits_of((1, 3), (3, 3), (0, 3), (2, 3), (0, 3), (1, 3), (0, 3), (3, 3))
    rates = [group.mean() for group in groups]
    found = estimate.alone_rate(groups)
    assert found.value == pytest.approx(np.mean(rates))
    assert found.error == pytest.approx(stats.sem(rates))
    assert found.interval == pytest.approx(score_ends(np.mean(rates), stats.sem(rates), 24.0, stats.t.ppf(0.975, 7)))
    unequal = hits_of((1, 1), (0, 25), (2, 4), (0, 25), (1, 2), (0, 1))
    rates = [1.0, 0.0, 0.5, 0.0, 0.5, 0.0]
    assert estimate.alone_rate(unequal).value == pytest.approx(1 / 3)
    assert estimate.alone_rate(unequal).error == pytest.approx(stats.sem(rates))


def trials_of(values: np.ndarray, key: str = "clearance", **more: float) -> list[PhysicalTrial]:
    return [PhysicalTrial(f"phi{index}", {key: float(value)}, **more) for index, value in enumerate(values)]


def simulated_of(values: np.ndarray, key: str = "clearance") -> dict[str, list[PhysicalTrial]]:
    return {f"phi{index}": [PhysicalTrial(f"phi{index}", {key: float(value)})] for index, value in enumerate(values)}


def test_without_prediction_the_physical_trials_stand_alone():
    y, x, every = drawn(np.random.default_rng(4), 0.95, 12)
    ((good,), _) = fuse(trials_of(y + 5.0), simulated_of(every + 5.0))
    assert good.predicts
    assert good.stands is good.with_simulator
    assert good.saved > 20
    ((bad,), _) = fuse(trials_of(y + 5.0), simulated_of(5.0 - every))
    assert bad.why_alone == "the simulator does not predict this figure"
    assert bad.stands is bad.alone
    assert bad.saved == 0
    assert bad.stands.interval == good.alone.interval
    assert good.as_dict()["gap"]["by_phi"][3]["gap"] == pytest.approx(float(y[3] - x[3]))


def test_intervals_at_several_looks_have_the_confidence_of_one_of_them():
    y, _, every = drawn(np.random.default_rng(4), 0.95, 12)
    (once,), (often,) = (fuse(trials_of(y), simulated_of(every), looks=looks)[0] for looks in (1, 4))
    assert (once.confidence, often.confidence) == (0.95, nominal_confidence(4))
    assert often.stands.interval[0] < once.stands.interval[0] < once.stands.interval[1] < often.stands.interval[1]


def test_refusals_of_trials():
    y, _, every = drawn(np.random.default_rng(8), 0.9, 8)
    simulated = simulated_of(every)
    few = trials_of(y[: estimate.LEAST_PAIRS - 1])
    with pytest.raises(UsageError, match="at least 5 φ"):
        fuse(few * 4, simulated)
    with pytest.raises(UsageError, match="'phix' was not simulated; did you mean 'phi"):
        fuse([*trials_of(y), PhysicalTrial("phix", {"clearance": 1.0})], simulated)
    with pytest.raises(UsageError, match="has no clearance"):
        fuse([*trials_of(y), PhysicalTrial("phi20", {"margin": 1.0})], simulated)
    with pytest.raises(UsageError, match="no figure in common"):
        fuse(trials_of(y, "margin"), simulated)
    with pytest.raises(UsageError, match="on every φ with trials"):
        fuse(trials_of(np.zeros(8)), simulated)


def test_pairs_are_of_one_timing():
    y, _, every = drawn(np.random.default_rng(9), 0.9, 8)
    runs = {
        name: [PhysicalTrial(name, {"clearance": trials[0].values["clearance"] + gap}, gap) for gap in (13.0, 15.0)]
        for name, trials in simulated_of(every).items()
    }
    near = fuse(trials_of(y, gap=13.2), runs)[0][0].pairs
    assert near.simulated == pytest.approx(every[:8] + 13.0)
    assert near.population.mean() == pytest.approx(every.mean() + 14.0)
    assert sorted(near.shape) == pytest.approx(sorted([*(every + 13.0), *(every + 15.0)]))
    with pytest.raises(UsageError, match=r"14\.00 m before the crossing line.*13\.00 to 15\.00 m"):
        fuse(trials_of(y, gap=14.0), runs)


def test_gaps_and_their_trends():
    rng = np.random.default_rng(10)
    x = rng.uniform(0.0, 2.0, 15)
    y = 0.3 + 1.5 * x + 0.01 * rng.standard_normal(15)
    order = rng.permutation(15)
    found = gap_of(y, x, y[order], x[order])
    assert found.mean == pytest.approx(np.mean(y - x))
    assert found.interval == pytest.approx(stats.t.interval(0.95, 14, np.mean(y - x), stats.sem(y - x)))
    by_scipy = stats.linregress(x, y - x)
    assert found.by_simulated.slope == pytest.approx(by_scipy.slope)
    assert found.by_simulated.p_value == pytest.approx(by_scipy.pvalue, abs=1e-12)
    assert trend(np.ones(5), np.arange(5.0)) is None


def test_of_trials_on_alike_phi_nothing_is_said():
    """A few φ decide the mean, and none of them has a trial."""
    rng = np.random.default_rng(11)
    every = np.concatenate([3.0 + 0.1 * rng.standard_normal(600), np.full(400, 9.0)])
    y = every[:10] + 0.02 * rng.standard_normal(10)
    with pytest.raises(UsageError, match=r"too alike.*make more trials"):
        fuse(trials_of(y), simulated_of(every))
    chosen = [*range(7), 950, 960, 970]
    values = (float(every[index] + 0.02 * rng.standard_normal()) for index in chosen)
    spread = [PhysicalTrial(f"phi{index}", {"clearance": one}) for index, one in zip(chosen, values, strict=True)]
    assert fuse(spread, simulated_of(every))[0][0].predicts


def test_the_reach_is_that_of_the_studentised_mean_of_such_figures():
    """Of exponential figures, by drawing them: the lower quantile of the studentised mean asks for the upper end."""
    rng = np.random.default_rng(12)
    every = stats.expon.ppf((np.arange(2000) + 0.5) / 2000)
    drawn_ones = rng.exponential(size=(40_000, 12))
    studentised = (drawn_ones.mean(axis=1) - 1.0) / (drawn_ones.std(axis=1, ddof=1) / math.sqrt(12))
    above = -np.quantile(studentised, 0.025) / stats.t.ppf(0.975, 11)
    reach = estimate.rehearsed(every, 12, 0.95, by_line=False, mirrored=False, least=0.0)
    assert reach[1] == pytest.approx(above, rel=0.12)  # 3.5 standard errors of a quantile of 2,000 draws
    assert reach[0] == 1.0
    assert estimate.rehearsed(every, 12, 0.95, by_line=False, mirrored=True, least=0.0) == reach[::-1]
    shuffled = estimate.rehearsed(
        7.0 + 3.0 * rng.permutation(every), 12, 0.95, by_line=False, mirrored=False, least=0.0
    )
    assert shuffled == pytest.approx(reach)


def test_few_trials_of_a_figure_that_few_phi_decide_are_refused():
    rng = np.random.default_rng(14)
    every = np.where(np.arange(2000) % 40 == 0, 9.0, 0.1 * rng.random(2000))
    assert estimate.kurtosis(every) == pytest.approx(stats.kurtosis(every, fisher=False))
    y = every[:12] + 0.2 * rng.random(12)
    with pytest.raises(UsageError, match=r"a few φ decide the mean.*at least 20 φ"):
        fuse(trials_of(y, "required_deceleration"), simulated_of(every, "required_deceleration"))


def test_a_simulator_that_is_right_so_far_may_be_wrong_some_day():
    """Partly a yes or no: beside the residuals one trial counts in which the simulator said nothing."""
    y, _, every = drawn(np.random.default_rng(16), 0.95, 12)
    figures = [FIGURES[key] for key in ("margin", "required_deceleration")]
    plain, partly = (fused_figure(one, paired_of(y + 5.0, every + 5.0, one.key), 0.95).stands for one in figures)
    line = estimate.fitted_line(y, every[:12])
    expected = math.sqrt((10.0 * line.residual + np.var(y, ddof=1)) / (11.0 * line.residual))
    assert partly.value == plain.value
    assert partly.error / plain.error == pytest.approx(expected, rel=0.02)  # but for the error of the simulated mean


def paired_of(y: np.ndarray, every: np.ndarray, key: str) -> Pairs:
    return paired(FIGURES[key], trials_of(y, key), simulated_of(every, key))


@pytest.mark.parametrize(("rho", "trials"), [(0.5, 10), (0.8, 10), (0.9, 20)])
def test_expected_widths_are_those_of_drawn_trials(rho, trials):
    rng, widths = np.random.default_rng(trials), []
    for _ in range(2000):
        x, other = rng.standard_normal((2, trials))
        y, centre = rho * x + math.sqrt(1.0 - rho**2) * other, rng.standard_normal() / math.sqrt(500.0)
        line = estimate.fitted_line(y, x)
        squared = line.residual * (1.0 / trials + (centre - x.mean()) ** 2 / line.spread)
        error = math.sqrt(squared + (line.slope or 0.0) ** 2 / 500)
        alone, both = stats.t.ppf(0.975, [trials - 1, trials - 2])
        widths.append((2.0 * alone * stats.sem(y), 2.0 * both * error))
    alone, both = np.mean(widths, axis=0)
    assert estimate.width_alone(trials, 1.0) == pytest.approx(alone, rel=0.02)
    assert estimate.width_fused(trials, 1.0, rho, 500) == pytest.approx(both, rel=0.03)


def test_the_least_number_of_trials():
    for width in (0.5, 1.0):
        alone = estimate.trials_for_width(width, 1.0)
        both = estimate.trials_for_width(width, 1.0, 0.9, 5000)
        assert estimate.width_alone(alone, 1.0) <= width < estimate.width_alone(alone - 1, 1.0)
        assert both < alone / 2
    assert estimate.trials_for_width(0.01, 1.0, 0.9, 50) is None  # what 50 simulated φ leave open is wider
    assert estimate.trials_for_width(9.0, 1.0) == 5


PLAN = ("fuse", "--figure", "clearance", "--width", "0.1")


@pytest.fixture(scope="module")
def fused_plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder, rng = tmp_path_factory.mktemp("plan"), np.random.default_rng(0)
    values = 1.0 + rng.random(400)
    rows = [f"w{index},{value}" for index, value in enumerate(values)]
    real = [f"w{index},{value - 0.3 + 0.1 * rng.standard_normal()}" for index, value in enumerate(values[:10])]
    for name, lines in (("simulated.csv", rows), ("real.csv", real)):
        (folder / name).write_text("\n".join(["phi,clearance", *lines]), encoding="utf-8")
    words = (folder / "simulated.csv", folder / "real.csv", "--out", folder / "fused", "--quiet")
    assert run_skd("fuse", *words) == 0
    return folder / "fused"


def test_the_command_plans_with_what_was_fused(fused_plan: Path, capsys: pytest.CaptureFixture[str]):
    words = (*PLAN, fused_plan)
    assert run_skd(*words, "--json") == 0
    said = json.loads(capsys.readouterr().out)
    found = json.loads((fused_plan / "fusion.json").read_text("utf-8"))["figures"]["clearance"]
    assert said["deviation"] == pytest.approx(found["deviation"])
    assert said["correlation"] == pytest.approx(found["correlation"])
    known = next(row for row in said["with_simulator"] if row["correlation"] == said["correlation"])
    assert known["trials"] == estimate.trials_for_width(0.1, said["deviation"], said["correlation"], 400)
    assert said["physical_alone"] > 2 * known["trials"]
    assert run_skd(*words, "--correlation", "0.6") == 0
    assert "where ρ = 0.60" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("FUSED",), "give PHYSICAL, the table of trials, or --width"),
        (("--width", "0.1", "FUSED"), "has no margin of skd fuse"),
    ],
)
def test_plans_that_cannot_be(fused_plan: Path, capsys: pytest.CaptureFixture[str], words, says):
    assert run_skd("fuse", *(fused_plan if word == "FUSED" else word for word in words)) == 2
    assert says in capsys.readouterr().err
