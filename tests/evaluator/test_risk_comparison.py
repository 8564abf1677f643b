"""Two cars by margin and risk: safer is who is so by one of them, while no estimate of the others points elsewhere."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from skd_evaluator.assessment.compare.comparison import INCONCLUSIVE, LESS_SAFE, SAFER, Comparison, compare
from skd_evaluator.assessment.context import RiskRequest
from skd_evaluator.assessment.files.results import StoredResult, read_result, write_assessment
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.metrics.behaviour.model import Parameter, load_behaviour
from skd_evaluator.metrics.difference import Difference
from skd_sim.options.adversary import Objective
from skd_sim.scenario.scenario import load_scenario
from stages import rate, with_margins, with_risks

PLAN = Plan(load_scenario("crossing"), safe_count=4, kamikaze_count=2, collision_runs=4, seed=5, simulations=20)
WALKERS = load_behaviour("walkers")
OTHERS = replace(WALKERS, name="others", parameters={**WALKERS.parameters, "pace": Parameter(0.3, "assumed")})


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, StoredResult]:
    found = {}
    with InProcessRunner(1) as runner:
        safe = safe_trajectories(PLAN, runner)
        for name, multiplier, behaviour in (("A", 0.6, WALKERS), ("B", 1.4, WALKERS), ("C", 1.4, OTHERS)):
            rating = rate(replace(PLAN, multiplier=multiplier), [Objective.DEVIATION], safe, runner)
            rating = with_margins(rating, runner, 50)
            rating = with_risks(rating, RiskRequest(behaviour, runs=400), runner)
            folder = tmp_path_factory.mktemp("risks") / name
            folder.mkdir()
            write_assessment(folder, rating)
            found[name] = read_result(folder)
    return found


def test_margin_and_risk_agree(results):
    found = compare(results["A"], results["B"])
    assert found.verdict == SAFER
    assert found.votes == {"margin": 1, "risk_1": 1, "risk_2": 1, "risk_3": 1}
    assert compare(results["B"], results["A"]).verdict == LESS_SAFE
    risk = found.differences["risk_1"]
    assert risk.paired
    assert risk.value == pytest.approx(results["B"].figures["risk_1"] - results["A"].figures["risk_1"])
    assert risk.confidence == pytest.approx(1.0 - 0.05 / 3)


def test_risks_of_unlike_behaviour_models_are_not_compared(results):
    found = compare(results["A"], results["C"])
    assert list(found.votes) == ["margin"]
    assert any("their behaviour models are walkers and others" in line for line in found.lines())


def leant(results: dict[str, StoredResult], sign: float, **figures: tuple[float, int]) -> Comparison:
    """Return a comparison in which each figure is so many standard errors of 0.1 off, and tells apart or does not."""
    differences = {}
    for name, (off, told_apart) in figures.items():
        value = sign * 0.1 * off
        half = 0.5 * abs(value) if told_apart else 2.0 * abs(value) + 0.1
        differences[name] = Difference(value, (value - half, value + half), 0.95, 0.1, 0.1, 9.0, 1.0, True)
    pair = (results["A"], results["B"]) if sign > 0.0 else (results["B"], results["A"])
    return Comparison(*pair, differences, (4, 4), (), "", ())


@pytest.mark.parametrize(
    ("figures", "verdict", "opposed"),
    [
        ({"margin": (3.0, 1), "risk_2": (-1.0, 0)}, SAFER, ()),
        ({"margin": (0.0, 0), "risk_1": (0.0, 0), "risk_2": (-3.0, 1)}, SAFER, ()),
        ({"margin": (0.0, 0), "risk_1": (0.0, 0), "risk_2": (0.0, 0)}, INCONCLUSIVE, ()),
        ({"margin": (-3.0, 1), "risk_1": (3.0, 1)}, LESS_SAFE, ()),
        ({"margin": (0.0, 0), "risk_1": (3.0, 1), "risk_2": (-3.0, 1)}, INCONCLUSIVE, ()),
        ({"margin": (3.0, 1), "risk_2": (0.6, 0)}, INCONCLUSIVE, ("risk_2",)),
        ({"margin": (3.0, 1), "risk_2": (0.4, 0)}, SAFER, ()),
        ({"margin": (3.0, 1), "risk_1": (0.0, 0), "risk_2": (0.0, 0)}, SAFER, ()),
        ({"margin": (-0.1, 0), "risk_1": (-3.0, 1), "risk_2": (-1.0, 0)}, SAFER, ()),
        ({"margin": (-0.7, 0), "risk_1": (-3.0, 1), "risk_2": (1.0, 0)}, INCONCLUSIVE, ("margin", "risk_2")),
        ({"margin": (0.7, 0), "risk_1": (3.0, 1)}, INCONCLUSIVE, ("margin",)),
        ({"margin": (3.0, 1), "risk_1": (2.0, 0), "risk_3": (2.0, 0)}, SAFER, ()),
        ({"margin": (3.0, 1), "risk_1": (2.0, 1)}, INCONCLUSIVE, ()),
        ({"margin": (-0.7, 0), "risk_1": (0.6, 0)}, INCONCLUSIVE, ()),
        ({"margin": (-3.0, 1), "risk_1": (-3.0, 1), "risk_2": (0.6, 0)}, INCONCLUSIVE, ()),
    ],
)
def test_an_estimate_that_points_the_other_way_withholds_the_verdict(figures, verdict, opposed, results):
    """More margin is safer, more risk is not; half a standard error is a tie, as no hit beside no hit is.

    Risks at other scales than that which ranks cars oppose where they are sure.
    """
    found = leant(results, 1.0, **figures)
    assert (found.verdict, found.opposed) == (verdict, opposed)


@given(
    figures=st.dictionaries(
        st.sampled_from(["margin", "risk_1", "risk_2", "risk_3"]),
        st.tuples(st.floats(-4.0, 4.0), st.integers(0, 1)),
        min_size=1,
    )
)
def test_no_car_is_safer_from_both_sides(figures, results):
    there, back = (leant(results, sign, **figures) for sign in (1.0, -1.0))
    mirrored = {SAFER: LESS_SAFE, LESS_SAFE: SAFER}
    assert back.verdict == mirrored.get(there.verdict, there.verdict)
    assert back.opposed == there.opposed
    better = {name: off if name == "margin" else -off for name, (off, _) in figures.items()}
    if there.verdict == SAFER:
        assert min(better.get("margin", 0.0), better.get("risk_2", 0.0)) >= -0.5
        assert any(told_apart and better[name] > 0.0 for name, (_, told_apart) in figures.items())


@pytest.mark.parametrize(
    ("figures", "behind"),
    [
        ({"margin": (-3.0, 1), "risk_2": (-1.0, 0)}, "margin"),
        ({"margin": (0.7, 0), "risk_1": (3.0, 1)}, "risk_1"),
        ({"margin": (-3.0, 1), "risk_1": (-3.0, 1)}, None),
        ({"margin": (3.0, 1), "risk_2": (1.0, 0)}, None),
        ({"margin": (-3.0, 0), "risk_2": (1.0, 0)}, None),
    ],
)
def test_a_gate_does_not_wait_until_all_estimates_point_one_way(figures, behind, results):
    """Who surely has less margin does not pass because a risk points the other way and is not sure."""
    assert leant(results, 1.0, **figures).behind_by == behind
