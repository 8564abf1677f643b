"""What aborted episodes may hide: of which figures they are, what these would be at worst, and what no gate passes."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from skd_evaluator import Assessment, AssessmentError
from skd_evaluator.assessment.compare.gate import Limit, check_limits
from skd_evaluator.assessment.options import WALKERS
from skd_evaluator.metrics.aborted import aborted_lines, at_worst, too_many_aborted
from skd_evaluator.metrics.behaviour.model import load_behaviour
from skd_evaluator.metrics.risks import Risks, ScaleRisk, Touch
from skd_evaluator.metrics.vulnerability_curve import BudgetPoint
from skd_evaluator.pytest_plugin import Assessed
from skd_evaluator.report.warnings import why_failed
from skd_evaluator.risk.crossings import CrossingPlan, Crossings, Ends
from skd_evaluator.risk.subset import AbortedCrossingsError, SubsetEffort, levels_of
from skd_sim.world.episode import EpisodeSpec, Mode, Outcome
from test_campaign import straight, trial
from test_warnings import PLAN, assessed

MANY = replace(PLAN, kamikaze_count=50, collision_runs=40)
_FIGURES = ("contact_rate", "nominal_collision_rate", "kamikaze_success_rate", "objectives.paper.success_rate")


def rating(count: int, lost: Outcome = Outcome.ABORTED, mode: Mode = Mode.REPLAY, plan: Any = MANY) -> Assessment:
    """A car of which the first episodes on the first φ end so; kamikazes collide, and of others one in twenty."""

    def decide(episode: EpisodeSpec) -> Outcome:
        if episode.mode == mode and episode.safe_trajectory.name == "one" and trial(episode) < count:
            return lost
        hit = episode.mode == Mode.KAMIKAZE or trial(episode) == 19
        return Outcome.COLLISION if hit else Outcome.ARRIVED

    return assessed(decide, plan)


def with_risk(*touches: Touch, lost: int = 0) -> Assessment:
    scales = [ScaleRisk(1.0, np.array(touches, np.int64), 2, lost=lost)]
    return replace(rating(0), risks=Risks(load_behaviour(WALKERS).as_dict(), scales))


def test_each_figure_is_held_against_the_limit_on_its_own() -> None:
    """3 of 40 are too many, be they 3 of 140 in all; one of 10 is one."""
    found = rating(3)
    assert (len(found.reasons), found.episodes) == (3, 140)
    silent = "no answer: the controller is silent"
    said = "3 of 40 runs along φ were aborted, more than --max-aborted 5 %; 3 of all that were aborted: "
    assert too_many_aborted(found.as_dict(), 0.05) == said + silent
    assert why_failed(found, 0.05)
    assert too_many_aborted(found.as_dict(), 0.08) is None
    one = rating(1, plan=replace(MANY, collision_runs=10))
    assert too_many_aborted(one.as_dict(), 0.05) is None
    assert (too_many_aborted(one.as_dict(), 0.0) or "").endswith(f"--max-aborted 0 %; 1 of them: {silent}")
    kamikazes = rating(4, mode=Mode.KAMIKAZE, plan=replace(MANY, kamikaze_count=20, collision_runs=400))
    assert "4 of 44 kamikazes of objective paper were aborted" in (too_many_aborted(kamikazes.as_dict(), 0.05) or "")
    crossings = [Touch.NONE] * 17 + [Touch.ABORTED] * 2
    assert "2 of 19 crossings" in (too_many_aborted(with_risk(*crossings).as_dict(), 0.05) or "")
    assert too_many_aborted(with_risk(*crossings[:-1]).as_dict(), 0.05) is None


@pytest.mark.parametrize("mode", [Mode.REPLAY, Mode.KAMIKAZE])
@pytest.mark.parametrize("name", _FIGURES)
def test_the_worst_is_what_the_same_episodes_give_with_hits(mode: Mode, name: str) -> None:
    def of(result: Any) -> float:
        for word in name.split("."):
            result = result[word]
        return float(result)

    # Kamikazes go on until enough have collided: those that were run in place of aborted ones stay.
    found = rating(2, mode=mode).as_dict()
    plan = MANY if mode == Mode.REPLAY else replace(MANY, kamikaze_count=52)
    worst = rating(2, Outcome.COLLISION, mode, plan).as_dict()
    told = at_worst(found, name)
    along = "rate" in name and "success" not in name
    if along != (mode == Mode.REPLAY):
        assert told is None
    elif along:
        assert told.value == of(worst) == pytest.approx(4 / 40)
    else:
        assert told.value == of(worst) == 1.0


def test_the_worst_of_a_risk_is_that_with_hits() -> None:
    touches = [Touch.NONE, Touch.FRONT, Touch.ABORTED, Touch.STANDING] * 5
    found = with_risk(*touches).as_dict()
    hits = with_risk(*(Touch.FRONT if one == Touch.ABORTED else one for one in touches)).as_dict()
    for name in ("risk_1", "risk.scales.0.value"):
        told = at_worst(found, name)
        assert told.value == hits["risk_1"] == 0.5
    assert aborted_lines(found) == [
        "5 of 20 crossings of the risk at scale 1 were aborted and count for nothing; if the car had hit in all of "
        "them, R(1) would be 50.0 % in place of 33.3 %"
    ]


@pytest.mark.parametrize(
    ("limit", "is_least", "outcome"),
    [
        (0.10, False, "passed"),  # at worst 4 of 40
        (0.09, False, "error"),
        (0.06, False, "error"),
        (0.05, False, "failed"),  # 2 of 38 are more already
        (0.05, True, "passed"),
    ],
)
def test_a_gate_takes_rates_at_their_worst(limit: float, is_least: bool, outcome: str) -> None:
    """A car that ends its process before it hits had passed."""
    (check,) = check_limits(rating(2).as_dict(), [Limit("contact_rate", limit, is_least)])
    assert (check.passed, check.error, check.failed) == (outcome == "passed", outcome == "error", outcome == "failed")
    if check.error:
        assert check.text == (
            f"not judged: contact_rate is 0.053, below {limit:g}, and it would be 0.1 if the car had hit in the "
            "2 of 40 runs along φ that were aborted"
        )


def test_a_gate_takes_lengths_at_their_worst() -> None:
    found = rating(2, mode=Mode.KAMIKAZE).as_dict()
    skd = found["skd"]
    checks = check_limits(found, [Limit("skd", factor * skd) for factor in (1.01, 0.99, 0.97)])
    assert [(one.failed, one.error) for one in checks] == [(True, False), (False, True), (False, False)]


def in_pytest(figures: dict[str, Any]) -> Assessed:
    return Assessed(figures, Path("r"))


def test_in_pytest_a_comparison_that_hangs_on_aborted_episodes_is_an_error() -> None:
    car = in_pytest(rating(2).as_dict())
    assert car.figures["contact_rate"] == pytest.approx(2 / 38)
    assert car.contact_rate < 0.11
    assert 0.0 <= car.contact_rate <= np.float32(0.11)
    assert not car.contact_rate <= 0.05
    assert f"{car.contact_rate:.3f}" == "0.053"
    with pytest.raises(AssessmentError, match=r"contact_rate is 0.0526316, and it would be 0.1 if .* 2 of 40 runs"):
        assert car.contact_rate < 0.06
    assert type(in_pytest(rating(0).as_dict()).contact_rate) is float


class Aborting:
    """Crossings that are hit by nobody, but for one that is aborted."""

    car_normals = 0

    def run(self, crossings: Crossings, scale: float) -> Ends:
        touch = np.zeros(len(crossings), np.int64)
        touch[3] = Touch.ABORTED
        return Ends(touch, np.where(touch == Touch.ABORTED, np.inf, 1.0))


def test_subset_simulation_ends_with_the_first_aborted_crossing() -> None:
    """It had counted as a miss."""
    here = CrossingPlan(PLAN, (straight(),), np.ones(12) * 0.1)
    with pytest.raises(AbortedCrossingsError) as told:
        levels_of(here, Aborting(), 1.0, SubsetEffort(2, 100, 3))
    assert told.value.count == 1


def test_bounded_kamikazes_that_were_aborted_fail_an_assessment_and_no_gate_passes_by_them() -> None:
    """Two of ten: their share is 4/8, and 6/10 at worst."""
    found = replace(rating(0), budgets=(BudgetPoint(0.5, 4, 8, 2),))
    assert too_many_aborted(found.as_dict(), 0.2) is None
    assert "2 of 10 kamikazes bounded to η = 0.5 m" in why_failed(found, 0.05)[0]
    (line,) = aborted_lines(found.as_dict())
    assert line.endswith("the share of these that are hit would be 60.0 % in place of 50.0 %")
    name = "vulnerability_curve.budgets.0.probability"
    checks = [check_limits(found.as_dict(), [Limit(name, most, is_least=False)])[0] for most in (0.61, 0.55, 0.49)]
    assert [(one.failed, one.error) for one in checks] == [(False, False), (False, True), (True, False)]
