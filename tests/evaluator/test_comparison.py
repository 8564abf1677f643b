"""Verdicts of `skd compare`, of results whose figures are given."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from skd_evaluator.campaign.comparison import LESS_SAFE, NOT_COMPARED, NOT_TOLD_APART, SAFER, compare
from skd_evaluator.campaign.stored_result import StoredResult
from skd_evaluator.measure.vulnerability_curve import vulnerability_curve
from skd_sim.encounter.scenario import load_scenario

FIGURES: dict[str, Any] = {
    "eta_max": 5.0,
    "scenario": load_scenario("crossing").as_dict(),
    "safe": "synthetic",
    "seed": 0,
    "simulations": 1000,
    "version": "1",
    "maximum_distance": None,
}
PHI = tuple(np.full((3, 2), float(index)) for index in range(8))


def result(name: str, values: np.ndarray, phi=PHI, objective: str = "deformation", **changes: Any) -> StoredResult:
    groups = {figure: tuple(values) for figure in ("deformation", "skd", "skd_prefix", "collision_rate")}
    curve = vulnerability_curve(list(values), 5.0)
    assert curve is not None
    return StoredResult(Path(name), {**FIGURES, **changes}, tuple(phi), curve, objective, groups)


def values(seed: int, phi: int = 8, shift: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return 1.0 + shift + 0.5 * rng.random((phi, 1)) + 0.1 * rng.random((phi, 20))


def test_on_the_same_phi_it_is_the_paired_test() -> None:
    one, other = values(1), values(1, shift=0.02) + 0.05 * np.random.default_rng(9).random((8, 20))
    found = compare(result("a", one), result("b", other))
    theirs = stats.ttest_rel(other.mean(axis=1), one.mean(axis=1))
    assert found.differences["deformation"].p_value == pytest.approx(theirs.pvalue, rel=1e-6)
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
    assert found.differences["deformation"].interval == pytest.approx((0.5, 0.5))
    assert found.phi == (4, 4)
    assert "4 of 8 and 4 φ in common" in found.warnings[0]


def test_on_other_phi_it_is_welchs_test_and_says_so() -> None:
    one, other = values(1), values(2, 5, shift=0.05)
    elsewhere = [*PHI[:2], *(phi + 0.5 for phi in PHI[:3])]  # two by chance the same
    found = compare(result("a", one), result("b", other, elsewhere, seed=1))
    welch = stats.ttest_ind(other.mean(axis=1), one.mean(axis=1), equal_var=False)
    assert found.differences["deformation"].p_value == pytest.approx(welch.pvalue, rel=1e-6)
    assert (found.verdict, found.design) == (NOT_TOLD_APART, "unpaired, 8 and 5 φ")
    assert "two samples" in found.warnings[0]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"eta_max": 4.0}, "different η_max, 5 and 4"),
        ({"objective": "paper"}, "different objectives, deformation and paper"),
        ({"maximum_distance": 1.0}, "different maximum distances"),
        ({"scenario": {**FIGURES["scenario"], "horizon": 9.0}}, "horizon is 12.0 and 9.0"),
        ({"safe": "folder", "safe_of": [phi + 0.5 for phi in PHI]}, "different φ, from synthetic and folder"),
    ],
)
def test_what_does_not_compare_has_no_verdict(changes: dict[str, Any], said: str) -> None:
    safe = changes.pop("safe_of", PHI)
    found = compare(result("a", values(1)), result("b", values(1, shift=1.0), safe, **changes))
    assert (found.verdict, found.differences) == (NOT_COMPARED, {})
    assert said in found.refusals[0]


def test_a_cars_own_part_of_the_scenario_may_differ() -> None:
    car = {**FIGURES["scenario"]["car"], "width": 2.0}
    found = compare(result("a", values(1)), result("b", values(1), scenario={**FIGURES["scenario"], "car": car}))
    assert found.refusals == ()
    assert found.verdict == NOT_TOLD_APART
    assert found.as_dict()["differences"]["deformation"]["p_value"] == 1.0


@pytest.mark.parametrize(("name", "value"), [("simulations", 500), ("version", "2")])
def test_what_makes_a_verdict_doubtful_is_said(name: str, value: Any) -> None:
    found = compare(result("a", values(1)), result("b", values(1, shift=1.0), **{name: value}))
    assert found.verdict == SAFER
    assert str(value) in found.warnings[0]
