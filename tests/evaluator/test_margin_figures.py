"""What the adversary of the margin can do, its mean, interval and curve, its equivalent multiplier, margins on disk."""

import json
import math

import numpy as np
import pytest
from cli_support import one_line
from hypothesis import given
from hypothesis import strategies as st
from report_support import edited
from scipy import stats
from scipy.optimize import brentq, isotonic_regression
from skd_adversary.crossing import road_users
from skd_adversary.crossing.road_users import road_user_named
from skd_evaluator.assessment.compare.comparison import compare
from skd_evaluator.assessment.files.results import read_result
from skd_evaluator.margin.actions import velocities
from skd_evaluator.metrics.deviation import Hit
from skd_evaluator.metrics.margins import Margins, difference, equivalent_entries, equivalent_multiplier, isotonic_means
from skd_evaluator.metrics.statistics import cantelli_bound, normal_interval, wilson_interval
from skd_evaluator.metrics.vulnerability_curve import vulnerability_curve
from skd_sim import Outcome, Trajectory, load_scenario


def margins(groups) -> Margins:
    """Return the margins of trials, m; infinity: nobody can be hit."""
    path = Trajectory(np.zeros((2, 2)), 0.3)
    hits = [[None if math.isinf(one) else Hit(one, path, 1.0, 5.0) for one in group] for group in groups]
    return Margins(tuple(map(tuple, hits)), 5.0)


def test_by_hand():
    found = margins([[0.0, 1.0, math.inf], [0.0, 2.0, 5.0]])
    assert (found.values.size, found.beyond) == (6, 1)
    assert found.mean == pytest.approx((0 + 1 + 5 + 0 + 2 + 5) / 6)
    curve = found.curve.as_dict()
    assert found.curve.probability(0.0).value == pytest.approx(2 / 6)
    assert curve["steps"]["eta"] == [0.0, 1.0, 2.0]
    np.testing.assert_allclose(curve["steps"]["probability"], [2 / 6, 3 / 6, 4 / 6])
    assert json.loads(json.dumps(curve, allow_nan=False))["area_above"] == pytest.approx(found.mean)
    for point in curve["points"]:
        low, high = point["ci95"]
        assert 0.0 <= low <= point["probability"] <= high <= 1.0


def test_the_interval_is_by_phi_and_reaches_further_up():
    rng = np.random.default_rng(5)
    groups = [list(np.clip(rng.normal(one, 0.1, 25), 0.0, 5.0)) for one in rng.normal(1.0, 0.3, 10)]
    found = margins(groups)
    low, high = found.ci95 or (0.0, 0.0)
    means = [np.mean(one) for one in groups]
    student = stats.t.interval(0.95, 9, np.mean(means), stats.sem(means))
    trials = normal_interval(found.values)
    assert trials[1] - trials[0] < 0.5 * (high - low)  # 250 trials are not independent
    assert 0.7 < (high - low) / (student[1] - student[0]) < 1.5
    assert high - found.mean > found.mean - low


def test_nothing_to_say_is_said():
    assert margins([[1.0, 2.0]]).ci95 is None
    alike = margins([[5.0, math.inf], [math.inf, 5.0]])
    assert alike.mean == 5.0
    assert alike.curve.as_dict()["steps"] == {"eta": [], "probability": []}
    assert any("same mean" in note for note in alike.clustered.notes)


@given(st.floats(0.0, 3.0), st.floats(0.01, 3.0), st.floats(0.001, 0.999))
def test_a_law_of_two_points_attains_cantelli(eta, above, share):
    """Of η with probability p and η + a else: mean and variance are known, and P(d ≤ η) = p."""
    mean, variance = eta + above * (1.0 - share), above**2 * share * (1.0 - share)
    assert cantelli_bound(eta, mean, variance) == pytest.approx(share, rel=1e-6)


@pytest.mark.parametrize(
    ("distances", "found"),
    [
        ([0.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0], 2.0),
        ([0.0, 0.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0], 0.0),
        ([1.0, 3.0], 1.2),
        ([0.7], 0.7),
        ([None, None, None], 5.0),
    ],
)
def test_it_is_the_tenth_between_order_statistics(distances, found):
    phi = Trajectory([[0.0, 0.0], [1.0, 0.0]], 0.3, "phi")
    ways = tuple(None if one is None else Hit(one, phi, 1.0, 4.0, 0.0) for one in distances)
    assert Margins((ways,), 5.0).quantile(0.1) == pytest.approx(found)


CROSSING, CYCLIST = load_scenario("crossing"), load_scenario("cyclist")
LIMITS = road_user_named("cyclist").parameters(CYCLIST)["own_limits"]


def test_a_cyclist_has_its_own_actions_from_its_own_state():
    step, most = CYCLIST.time_step, CYCLIST.adversary.speed
    straight = np.array([[-9.0 + 0.9 * k, 0.0] for k in range(8)])
    walked = straight[:2] + np.array([[0.0, 0.0], [0.0, 0.2]])
    found = velocities(CYCLIST, straight, 1, walked)
    heading, speed = math.atan2(0.2, 0.9), math.hypot(0.2, 0.9) / step
    expected = [road_users.ridden(LIMITS, heading, speed, action, most, step) for action in range(7)]
    assert found[:-1] == pytest.approx(np.array(expected))


def test_a_cyclist_goes_as_phi_as_far_as_it_can():
    step = CYCLIST.time_step
    straight = np.array([[-9.0 + 0.9 * k, 0.0] for k in range(8)])
    as_phi = velocities(CYCLIST, straight, 2, straight[:3])[-1]
    assert as_phi == pytest.approx([3.0, 0.0])
    # φ jumps aside: nobody rides so, whoever has been as φ before. 3 m/s is 1.8 m/s² less than √13 m/s and turns 33.7°.
    jump = straight.copy()
    jump[3:, 1] = 0.6
    bounded = velocities(CYCLIST, jump, 2, jump[:3])[-1]
    assert np.hypot(*bounded) == pytest.approx(3.0 + step * LIMITS.acceleration)
    turned = math.atan2(bounded[1], bounded[0])
    assert turned == pytest.approx(LIMITS.lateral * step / np.hypot(*bounded))
    # What is between its actions it can do.
    between = 2.8 * np.array([math.cos(0.1), math.sin(0.1)])
    reachable = np.vstack([straight[:3], straight[2] + step * between])
    assert velocities(CYCLIST, reachable, 2, straight[:3])[-1] == pytest.approx(between)


def test_a_result_whose_kamikazes_were_all_aborted_has_its_margin(sweep, tmp_path):
    """The margin is of no kamikaze: a car is judged where none ran."""
    found = []
    for name in ("C_0.5", "C_1"):
        folder = edited(sweep / "synthetic" / name, tmp_path / name, deviation=None)
        with np.load(folder / "episodes.npz") as arrays:
            aborted = dict(arrays)
        aborted["outcome"] = np.where(aborted["mode"] == 1, int(Outcome.ABORTED), aborted["outcome"]).astype(np.int8)
        np.savez_compressed(folder / "episodes.npz", **aborted)
        found.append(read_result(folder))
    assert found[0].curve is None
    held = compare(*found)
    assert held.judged_by == "margin"
    assert held.differences["margin"].value > 0.0
    assert "deviation" not in held.differences


def test_plan_goes_by_the_margin_and_refuses_unlike_kamikazes(skd_here, sweep, tmp_path):
    one, other = (sweep / "synthetic" / name for name in ("C_0.5", "C_1"))
    two = edited(other, tmp_path / "two", adversary_model="generic")
    done = skd_here("compare", str(one), str(two), "--difference", "0.3", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["figure"] == "margin"
    margins = [np.array(read_result(folder).groups["margin"]) for folder in (one, two)]
    within = (margins[1] - margins[0]).var(axis=1, ddof=1).mean()
    assert found["variance_within"] == pytest.approx(within)
    refused = skd_here("compare", str(one), str(two), "--difference", "0.3", "--figure", "deviation")
    one_line(refused, 2, "planned figures are not compared", "adversary model exact and generic")
    limited = edited(other, tmp_path / "limited", maximum_distance=2.0)
    refused = skd_here("compare", str(one), str(limited), "--difference", "0.3", "--figure", "deviation")
    one_line(refused, 2, "planned figures are not compared", "maximum distance (m) none and 2")


# --- The equivalent multiplier, and the vulnerability curve.


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
