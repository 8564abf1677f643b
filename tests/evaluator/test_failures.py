"""The most likely failures: why they happen, how near they are to how people walk, and that none can be made up."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy import signal
from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.context import RiskRequest
from skd_evaluator.assessment.failures import HARDLY, Walkers, failures_of, nine_normals
from skd_evaluator.assessment.files.results import write_assessment
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.risk import single_crossing
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.metrics.behaviour.model import load_behaviour, normals_of
from skd_evaluator.metrics.risks import ScaleRisk, Touch
from skd_evaluator.report.formats import kept_failures
from skd_evaluator.report.html.subjects import read_subjects
from skd_evaluator.report.repeat import repeat_crossing
from skd_sim.options.adversary import Objective
from skd_sim.scenario.scenario import load_scenario
from stages import rate, with_risks

PLAN = Plan(
    load_scenario("crossing"), safe_count=3, kamikaze_count=2, collision_runs=8, seed=5, simulations=20, multiplier=0.8
)
WALKERS = load_behaviour("walkers")
TICK = 0.3
ASKED = RiskRequest(WALKERS, runs=60)


@pytest.fixture(scope="module")
def rated() -> Assessment:
    with InProcessRunner(1) as runner:
        return rate(PLAN, [Objective.DEVIATION], safe_trajectories(PLAN, runner), runner)


@pytest.fixture(scope="module")
def found(rated) -> Assessment:
    with InProcessRunner(1) as runner:
        return with_risks(rated, ASKED, runner)


@pytest.fixture
def folder(found, tmp_path) -> Path:
    write_assessment(tmp_path, found)
    return tmp_path


def walkers(length: float = 2.4) -> Walkers:
    """φ leads straight across the lane, from West to East."""
    x = np.arange(-4.0, 4.0, length * TICK / 2.0)
    return Walkers(PLAN.scenario, [np.column_stack([x, np.zeros(x.size)])], 5, WALKERS.values)


def normals(**of: float) -> np.ndarray:
    """Normals of a walker: those of the person by name, of every tick by name and `_ticks`, all others 0."""
    zero = np.zeros(normals_of(PLAN.scenario.ticks))
    for name, value in of.items():
        if name.endswith("_ticks"):
            zero[4 + ["pace", "turn", "doubt", "along", "across"].index(name.removesuffix("_ticks")) :: 5] = value
        else:
            zero[["start", "pace", "heading", "unrest"].index(name)] = value
    return zero


@pytest.mark.parametrize(
    ("kind", "of"),
    [
        ("starts late", {"start": 2.0, "pace": 0.3}),
        ("starts early", {"start": -2.0}),
        ("walks fast", {"pace": 2.5}),
        ("walks slowly", {"pace": -2.5, "start": 0.3}),
        ("walks slowly", {"pace_ticks": -2.5, "unrest": 2.5}),
        ("drifts away from the car", {"turn_ticks": 1.0}),
        ("drifts towards the car", {"turn_ticks": -1.0}),
        ("hesitates before the lane", {"doubt_ticks": 1.0}),
        ("sways", {"along_ticks": 20.0}),
        (HARDLY, {}),
        (HARDLY, {"unrest": 3.0}),
    ],
)
def test_a_failure_is_named_by_what_led_furthest_from_phi(kind, of, monkeypatch):
    here = walkers()
    monkeypatch.setattr(Walkers, "normals", lambda _self, _row: normals(**of))
    assert here.failure(0, 1.0, 7).kind == kind


@pytest.mark.parametrize("ticks", [1, 2, 6, 15])
def test_nine_normals_are_standard_and_of_what_happened_before_the_contact(ticks):
    """The means of the processes, filtered by another library, over closed forms of their deviations."""
    drawn = np.random.default_rng(3).standard_normal(normals_of(40))
    mine = nine_normals(drawn, ticks, WALKERS.values, TICK)
    of_tick = drawn[4 : 4 + 5 * ticks].reshape(ticks, 5)
    lag = np.abs(np.subtract.outer(np.arange(ticks), np.arange(ticks)))
    for place, (column, time) in enumerate([(0, "pace_time"), (1, "turn_time")]):
        keep = math.exp(-TICK / WALKERS.parameters[time].value)
        inputs = of_tick[:, column] * np.r_[1.0, np.full(ticks - 1, math.sqrt(1 - keep**2))]
        mean = signal.lfilter([1.0], [1.0, -keep], inputs).mean()
        assert mine[4 + place] == pytest.approx(mean / math.sqrt((keep**lag).mean()))
    keep = math.exp(-TICK / WALKERS.parameters["hesitation_time"].value)
    covariance = (1.0 + lag * (1.0 - keep**2) / (1.0 + keep**2)) * keep**lag
    doubt = np.linalg.cholesky(covariance) @ of_tick[:, 2]  # the process that these innovations make
    assert mine[6] == pytest.approx(doubt.mean() / math.sqrt(covariance.mean()))
    np.testing.assert_array_equal(mine[:4], drawn[:4])
    np.testing.assert_array_equal(mine[7:], of_tick[-1, 3:])
    drawn[4 + 5 * ticks :] = 9.0
    np.testing.assert_array_equal(mine, nine_normals(drawn, ticks, WALKERS.values, TICK))


def walkers_of(rating: Assessment) -> Walkers:
    plan = rating.plan
    return Walkers(plan.scenario, [one.positions for one in rating.safe], plan.seed, WALKERS.values)


def risk(scale: float, hits: int, runs: int = 60) -> ScaleRisk:
    touches = np.array([Touch.FRONT] * hits + [Touch.NONE] * (runs - hits), np.int64)
    return ScaleRisk(scale, touches, 3, ticks=np.full(runs, 5))


@pytest.mark.parametrize(
    ("hits", "scale"), [((0, 0, 0), None), ((10, 30, 40), 1.0), ((9, 30, 40), 2.0), ((2, 5, 5), 2.0), ((1, 0, 0), 1.0)]
)
def test_failures_are_of_the_least_scale_that_has_enough(hits, scale, found):
    scales = [risk(one, count) for one, count in zip((1.0, 2.0, 3.0), hits, strict=True)]
    here = failures_of(scales, walkers_of(found))
    assert (None if here is None else here.scale) == scale
    if here is not None:
        assert here.looked_at == here.hits == sum(one.hits for one in here.kinds)


def test_they_are_the_same_whoever_runs_the_car(rated, found, monkeypatch):
    """Compiled crossings, and whole episodes in two processes."""
    monkeypatch.setattr("skd_evaluator.assessment.stages.risk.has_exact_margin", lambda *_of: False)
    with InProcessRunner(2) as runner:
        other = with_risks(rated, ASKED, runner).risks
    mine = found.risks
    assert json.dumps(mine.failures.as_dict()) == json.dumps(other.failures.as_dict())
    assert mine.failing.keys() == other.failing.keys()
    for row, log in mine.failing.items():
        np.testing.assert_array_equal(log.adversary, other.failing[row].adversary)
        np.testing.assert_array_equal(log.car, other.failing[row].car)


def test_one_is_read_back_and_repeated_to_the_bit(folder):
    (subject,) = read_subjects([folder])
    kept = kept_failures(subject.figures)
    assert len(kept) == len(subject.failing) > 3
    for number, one in enumerate(kept):
        words = repeat_crossing(subject.figures, int(subject.failing.episode_id[number]))
        of = dict(zip(words[2::2], words[3::2], strict=True))
        assert (of["--mode"], of["--behaviour"], float(of["--scale"])) == ("risk", "walkers", one.scale)
        log = run_episode(
            single_crossing(PLAN, WALKERS, int(of["--safe-number"]), int(of["--trial"]), float(of["--scale"]))
        )
        assert log.hit
        np.testing.assert_array_equal(log.adversary, subject.failing.adversary[number])
        np.testing.assert_array_equal(log.car, subject.failing.car[number])
        assert log.impact_time == subject.failing.impact_time[number]
