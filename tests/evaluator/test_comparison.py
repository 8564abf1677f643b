"""Verdicts of `skd compare`, of results whose figures are given."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from comparison_support import FIGURES
from scipy import stats
from skd_evaluator.assessment.compare.comparison import (
    INCONCLUSIVE,
    LESS_SAFE,
    NOT_COMPARED,
    SAFER,
    SAME,
    compare,
    ranking_figure,
)
from skd_evaluator.assessment.compare.gate import not_worse
from skd_evaluator.assessment.files.results import StoredResult
from skd_evaluator.metrics.aborted import NOT_CREDIBLE
from skd_evaluator.metrics.price_of_caution import HORIZON, HarmlessRun, PriceOfCaution
from skd_evaluator.metrics.vulnerability_curve import vulnerability_curve
from skd_sim.scenario.scenario import load_scenario

PHI = tuple(np.full((3, 2), float(index)) for index in range(8))
PLANNED = ("deviation", "skd", "skd_prefix")


def result(
    name: str, values: np.ndarray, phi=PHI, planned: np.ndarray | None = None, *, margin: bool = True, **changes: Any
) -> StoredResult:
    planned = values if planned is None else planned
    groups = {figure: tuple(values) for figure in ("margin", "nominal_collision_rate", "contact_rate")}
    groups |= {figure: tuple(planned) for figure in PLANNED}
    if not margin:
        del groups["margin"]
        changes = {"margin_converged": None, "margin_how": None, "margin_note": "no car to ask", **changes}
    curve = vulnerability_curve(list(planned), 5.0)
    return StoredResult(Path(name), {**FIGURES, **changes}, tuple(phi), curve, groups)


def values(seed: int, phi: int = 8, shift: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return 1.0 + shift + 0.5 * rng.random((phi, 1)) + 0.1 * rng.random((phi, 20))


def test_on_the_same_phi_it_is_the_paired_test() -> None:
    one, other = values(1), values(1, shift=0.02) + 0.05 * np.random.default_rng(9).random((8, 20))
    found = compare(result("a", one), result("b", other))
    theirs = stats.ttest_rel(other.mean(axis=1), one.mean(axis=1))
    assert found.differences["margin"].p_value == pytest.approx(theirs.pvalue, rel=1e-6)
    assert (found.verdict, found.design) == (SAFER, "paired on 8 φ and draws")
    assert compare(result("b", other), result("a", one)).verdict == LESS_SAFE
    assert found.warnings == ()
    again = compare(result("a", one), result("b", other, seed=3))
    assert again.design == "paired on 8 φ (other draws)"
    assert ["different seeds" in line for line in again.warnings] == [True]


def test_phi_are_paired_in_whatever_order_they_come_and_where_one_has_more() -> None:
    one, other = values(1), values(1, shift=0.5)
    order = [5, 2, 7, 0]
    found = compare(result("a", one), result("b", other[order], [PHI[index] for index in order]))
    assert found.differences["margin"].interval == pytest.approx((0.5, 0.5))
    assert found.phi == (4, 4)
    assert "compared on the 4 φ that both have, of 8 and 4" in found.warnings[0]


def test_on_other_phi_it_is_welchs_test_and_says_so() -> None:
    one, other = values(1), values(2, 5, shift=0.05)
    elsewhere = [*PHI[:2], *(phi + 0.5 for phi in PHI[:3])]  # two by chance the same
    found = compare(result("a", one), result("b", other, elsewhere, seed=1))
    welch = stats.ttest_ind(other.mean(axis=1), one.mean(axis=1), equal_var=False)
    assert found.differences["margin"].p_value == pytest.approx(welch.pvalue, rel=1e-6)
    assert (found.verdict, found.design) == (INCONCLUSIVE, "unpaired, 8 and 5 φ")
    assert "two samples" in found.warnings[0]


def scenario_of(name: str = "crossing", **changes: dict[str, Any]) -> dict[str, Any]:
    """A shipped scenario with other keys in some of its sections."""
    scenario = load_scenario(name).as_dict()
    return {**scenario, **{section: {**scenario[section], **keys} for section, keys in changes.items()}}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"eta_max": 4.0}, "different η_max, 5 and 4"),
        ({"scenario": {**FIGURES["scenario"], "horizon": 9.0}}, "horizon is 12.0 and 9.0"),
        ({"scenario": scenario_of(collision={"hit_speed": 2.0})}, "different hit speeds, 0.556 and 2 m/s"),
        ({"safe": "folder", "safe_of": [phi + 0.5 for phi in PHI]}, "different φ, from synthetic and folder"),
    ],
)
def test_what_does_not_compare_has_no_verdict(changes: dict[str, Any], said: str) -> None:
    safe = changes.pop("safe_of", PHI)
    found = compare(result("a", values(1)), result("b", values(1, shift=1.0), safe, **changes))
    assert (found.verdict, found.differences) == (NOT_COMPARED, {})
    assert said in found.refusals[0]


def test_tyres_on_two_roads_have_no_verdict_and_a_car_without_tyres_has_one_with_a_warning() -> None:
    """Of a car on ice and of the same on a dry road the latter was the safer one, without a word."""
    ice, dry, basic = (
        result(name, values(1, shift=shift), scenario=scenario)
        for name, shift, scenario in (
            ("ice", 0.0, scenario_of("crossing_multi_body", road={"friction": 0.2})),
            ("dry", 1.0, scenario_of("crossing_multi_body")),
            ("basic", 1.0, scenario_of()),
        )
    )
    found = compare(ice, dry)
    assert (found.verdict, found.differences) == (NOT_COMPARED, {})
    assert found.lines() == ["ice and dry are of different scenarios: road.friction is 0.2 and 1.0"]
    beside = compare(ice, basic)
    assert beside.verdict == SAFER
    assert beside.lines() == [
        "ice and basic are of different roads: road.friction is 0.2 and 1, and one of the cars has no tyres to feel it"
    ]
    assert compare(dry, basic).lines() == []


def test_a_result_that_is_not_credible_has_no_verdict() -> None:
    """Else a car that stands still is the safer one without a word."""
    told = result("b", values(1, shift=1.0), warnings=["harmless", f"{NOT_CREDIBLE}it stands"])
    for found in (compare(result("a", values(1)), told), compare(told, result("a", values(1)))):
        assert (found.verdict, found.differences) == (NOT_COMPARED, {})
        assert found.refusals == (f"b is not compared, for its own assessment failed: {NOT_CREDIBLE}it stands",)
    assert ranking_figure([result("a", values(1)), told]) is None


def test_a_cars_own_part_of_the_scenario_may_differ() -> None:
    car = {**FIGURES["scenario"]["car"], "width": 2.0}
    found = compare(result("a", values(1)), result("b", values(1), scenario={**FIGURES["scenario"], "car": car}))
    assert found.refusals == ()
    assert found.verdict == SAME
    assert found.as_dict()["differences"]["margin"]["p_value"] == 1.0


def test_the_margin_judges_where_planned_figures_are_of_unlike_adversary_models() -> None:
    first = result("a", values(1), planned=values(5, shift=2.0), adversary_model="generic")
    second = result("b", values(1, shift=0.5), planned=values(5), adversary_model="learned")
    found = compare(first, second)
    assert (found.verdict, found.judged_by) == (SAFER, "margin")
    assert found.planned_refusal == (
        "planned figures are not compared: a and b have adversary model generic and learned"
    )
    assert found.lines() == []
    assert not set(PLANNED) & set(found.differences)
    assert {"margin", "nominal_collision_rate", "contact_rate"} == set(found.differences)
    again = compare(first, result("b", values(1, shift=0.5), planned=values(5), adversary_model="generic"))
    assert set(PLANNED) < set(again.differences)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"objectives": {"paper": {}}}, "objective deviation and paper"),
        ({"maximum_distance": 1.0}, "maximum distance (m) none and 1"),
        ({"options": {"particles": 3}}, "particles the usual number and 3"),
    ],
)
def test_kamikazes_of_unlike_kind_are_not_compared_and_margins_are(changes: dict[str, Any], said: str) -> None:
    found = compare(result("a", values(1)), result("b", values(1, shift=1.0), **changes))
    assert (found.verdict, found.refusals) == (SAFER, ())
    assert said in found.planned_refusal
    assert "deviation" not in found.differences


def test_skd_of_other_kamikazes_is_left_out_where_deviations_compare() -> None:
    found = compare(result("a", values(1)), result("b", values(1), objectives={"deviation": {}}))
    assert "deviation" in found.differences
    assert "skd" not in found.differences


@pytest.mark.parametrize("shift", [-1.0, 0.0, 1.0], ids=["opposite", "unsure", "same"])
def test_planned_kamikazes_decide_nothing_beside_margins(shift: float) -> None:
    rng = np.random.default_rng(4)
    planned = values(6) + 1.0
    other = planned + shift + 0.05 * rng.standard_normal((8, 1))
    first = result("a", values(1), planned=planned)
    second = result("b", values(1, shift=0.5), planned=other)
    found = compare(first, second)
    assert found.differences["margin"].direction == 1
    assert found.differences["deviation"].direction == np.sign(shift)
    assert found.verdict == SAFER
    assert any("opposite" in line for line in found.lines()) == (shift < 0.0)
    assert not_worse(first, second).failed
    assert not not_worse(second, first).failed


OPEN = {"margin_converged": False, "margin_budget": 512}


def test_a_car_whose_margin_is_an_upper_bound_is_never_the_safer_one() -> None:
    """With a longer search it may have less than the other; less safe it may be called."""
    known, bound = result("a", values(1)), result("b", values(1, shift=1.0), **OPEN)
    for pair in ((known, bound), (bound, known)):
        found = compare(*pair)
        assert (found.verdict, found.votes["margin"]) == (INCONCLUSIVE, 0)
        assert found.reason == "upper bound"
        (line,) = found.lines()
        assert line.startswith("the margin of b is at most 2.3")
    least = result("c", values(1, shift=-0.5), **OPEN)
    assert (compare(known, least).verdict, compare(least, known).verdict) == (LESS_SAFE, SAFER)
    assert "the margin of c is at most 0.8" in compare(least, known).lines()[0]
    assert compare(least, known).reason == ""
    assert compare(least, bound).verdict == INCONCLUSIVE


@pytest.mark.parametrize(
    ("margins", "bound", "why"),
    [
        ((0.5, 1.0), "mine", "not judged: .*the margin is an upper bound"),
        ((1.5, 1.0), "earlier", "not judged: .*the earlier margin is an upper bound"),
        ((0.5, 1.0), "earlier", None),
        ((1.5, 1.0), "mine", "worse"),
    ],
)
def test_no_gate_passes_by_an_upper_bound(margins: tuple[float, float], bound: str, why: str | None) -> None:
    """Mine may be less than it says; an earlier one may be, and where it is the less anyhow it does no harm."""
    earlier, mine = (
        result(name, values(1, shift=margin), planned=np.ones((8, 20)), **(OPEN if name == bound else {}))
        for name, margin in zip(("earlier", "mine"), margins, strict=True)
    )
    check = not_worse(mine, earlier)
    assert (check.failed, check.error, check.passed) == (why == "worse", why not in (None, "worse"), why is None)
    if check.error:
        assert re.search(why or "", check.text)


def test_what_a_search_may_have_missed_is_in_the_interval_of_the_difference() -> None:
    """The mean excess, and its error in quadrature with that by φ: of the second car below, of the first above."""
    one, other = values(1), values(1, shift=0.1) + 0.05 * np.random.default_rng(9).random((8, 20))
    plain = compare(result("a", one), result("b", other)).differences["margin"]
    excess = {"margin_excess": {"mean": 0.04, "error": 0.02, "trials": 24}}
    found = compare(result("a", one), result("b", other, **excess)).differences["margin"]
    reach = stats.t.ppf(0.975, 7) * np.hypot(plain.standard_error, 0.02)
    assert found.interval == pytest.approx((plain.value - 0.04 - reach, plain.interval[1]))
    chance = 2 * stats.t.sf((plain.value - 0.04) / np.hypot(plain.standard_error, 0.02), 7)
    assert found.p_value == pytest.approx(chance)
    back = compare(result("b", other, **excess), result("a", one)).differences["margin"]
    assert back.interval == pytest.approx((-found.interval[1], -found.interval[0]))
    assert back.p_value == pytest.approx(chance)


def test_without_a_margin_planned_deviations_judge_and_it_is_said() -> None:
    first, second = (result(name, values(1, shift=shift), margin=False) for name, shift in (("a", 0.0), ("b", 1.0)))
    found = compare(first, second)
    assert (found.verdict, found.judged_by) == (SAFER, "deviation")
    (line,) = found.lines()
    assert line.startswith("no margin of a (no car to ask) and of b (no car to ask): judged by planned deviations")
    one = compare(result("a", values(1)), second)
    assert (one.judged_by, one.design) == ("deviation", "paired on 8 φ and draws")
    assert "no margin of b (no car to ask)" in one.lines()[0]


def test_without_a_margin_and_with_unlike_kamikazes_there_is_no_verdict() -> None:
    found = compare(result("a", values(1)), result("b", values(1, shift=1.0), margin=False, adversary_model="generic"))
    assert (found.verdict, found.judged_by) == (NOT_COMPARED, None)
    assert found.refusals == ()
    assert [line.partition(":")[0] for line in found.lines()] == [
        "planned figures are not compared", "no margin of b (no car to ask)",
    ]  # fmt: skip
    assert found.lines()[1].endswith("not judged")


@pytest.mark.parametrize(
    ("first", "second", "verdict"),
    [
        ((1.0, 6.0), (2.0, 6.0), "safer"),
        ((1.0, 6.0), (2.0, 10.7), "safer at the price of 4.7 s for each harmless road user"),
        ((2.0, 10.7), (1.0, 6.0), "less safe, and 4.7 s quicker for each harmless road user"),
        ((1.0, 10.7), (2.0, 6.0), "safer"),
        ((1.0, 6.0), (2.0, HORIZON), "not called safer, for it is often stuck"),
        ((2.0, HORIZON), (1.0, 6.0), "less safe, and 24.0 s quicker for each harmless road user"),
        ((1.0, HORIZON), (2.0, HORIZON), "safer"),
    ],
)
def test_the_verdict_names_the_price(first: tuple[float, float], second: tuple[float, float], verdict: str) -> None:
    found = [priced(str(margin), values(1, shift=margin), passed) for margin, passed in (first, second)]
    assert compare(*found).verdict == verdict


def priced(name: str, margins: np.ndarray, passed: float = 6.0, **changes: Any) -> StoredResult:
    runs = tuple(HarmlessRun("waits", passed, 6.0, 5.5, braked=False) for _ in range(60))
    return result(name, margins, price_of_caution=PriceOfCaution(runs).as_dict(), **changes)


@pytest.mark.parametrize(
    ("shift", "spread", "second", "verdict"),
    [
        (0.0, 0.0, 5.0, "as safe, and 1.0 s quicker for each harmless road user"),
        (0.0, 0.0, 7.5, "as safe, and 1.5 s slower for each harmless road user"),
        (0.0, 0.0, 6.0, SAME),
        (0.0, 0.3, 5.0, INCONCLUSIVE),  # nothing is known of their margins, which is not that they are the same
        (-0.5, 0.0, 5.0, "less safe, and 1.0 s quicker for each harmless road user"),
    ],
)
def test_who_is_as_safe_and_quicker_is_called_so(shift: float, spread: float, second: float, verdict: str) -> None:
    other = values(1, shift=shift) + spread * np.random.default_rng(2).standard_normal((8, 1))
    other += (values(1, shift=shift).mean() - other.mean()) if spread else 0.0
    found = compare(priced("a", values(1)), priced("b", other, second))
    assert found.verdict == verdict
    assert found.differences["time_lost"].value == pytest.approx(second - 6.0)


@pytest.mark.parametrize(
    ("faster", "share", "withheld"), [(2.5, 1.0, True), (1.5, 1.0, False), (2.5, 0.98, True), (2.5, 0.8, False)]
)
@pytest.mark.parametrize("same", [True, False], ids=["draws", "others"])
def test_a_car_that_is_hit_much_harder_is_not_called_safer(faster, share, same, withheld):
    rng, pair = np.random.default_rng(7), []
    speeds = 4.0 + rng.random((8, 20)) if same else np.full((8, 20), 4.0)
    harder = speeds + np.where(rng.permutation(160).reshape(8, 20) < 160 * share, faster, 0.0)
    harder[:, 0] = np.nan  # nobody is hit there
    for name, shift, impacts in (("a", 0.0, speeds), ("b", 1.0, harder)):
        one = result(name, values(1, shift=shift), seed=0 if same or name == "a" else 1)
        pair.append(replace(one, groups={**one.groups, "impact_speed": tuple(impacts)}))
    for found, plain in ((compare(*pair), SAFER), (compare(*pair[::-1]), LESS_SAFE)):
        assert found.verdict == (INCONCLUSIVE if withheld else plain)
        assert any("of the impacts of b are harder by more than 2 m/s" in line for line in found.lines()) == withheld
    assert compare(pair[0], result("c", values(2, 10))).harder == 0.0  # a car of which no impact is known


def test_an_upper_bound_of_a_car_that_does_not_get_past_is_no_safety() -> None:
    one = priced("a", values(1, shift=3.0), HORIZON, margin_converged=False)
    other = priced("b", values(1), margin_converged=False)
    assert compare(other, one).verdict == "not called safer, for it is often stuck"
    assert compare(one, other).verdict == "not called less safe, for the other is often stuck"
