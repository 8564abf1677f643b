"""The risk: compiled crossings are episodes to the bit, subset simulation agrees with crude runs, whoever computes."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli_support import SMALL
from scipy import signal, special, stats
from skd_evaluator import Assessment, Plan, run_episode
from skd_evaluator.assessment.context import RiskRequest
from skd_evaluator.assessment.failures import HARDLY, Walkers, failures_of, nine_normals
from skd_evaluator.assessment.files.results import write_assessment
from skd_evaluator.assessment.plan import split_episode_id
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.risk import RUNS, crude_crossings, draws_of, single_crossing
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.metrics.behaviour.model import load_behaviour, normals_of
from skd_evaluator.metrics.risks import ScaleRisk, Subsets, Touch, log_t_interval
from skd_evaluator.report.formats import kept_failures
from skd_evaluator.report.html.subjects import read_subjects
from skd_evaluator.report.repeat import repeat_crossing
from skd_evaluator.risk.crossings import IN_A_CURVE, SAME, AnyCar, CrossingPlan, Crossings, Ends, KnownCar, side_touched
from skd_evaluator.risk.subset import SubsetEffort, gathered, levels_of, replicate
from skd_sim import Outcome, Trajectory, load_scenario
from skd_sim.options.car_and_adversary import Objective
from stages import rate, with_risks

CROSSING = load_scenario("crossing")
PLAN = Plan(CROSSING, safe_count=3, kamikaze_count=2, collision_runs=8, seed=5, simulations=20)
WALKERS = load_behaviour("walkers")


@pytest.fixture(scope="module")
def safe() -> tuple[Trajectory, ...]:
    return tuple(safe_trajectories(PLAN, InProcessRunner(1)))


def crossing_plan(safe: tuple[Trajectory, ...], plan: Plan = PLAN) -> CrossingPlan:
    return CrossingPlan(plan, safe, WALKERS.values)


def recorded() -> Trajectory:
    """A walk at a pace of its own, which the car meets."""
    seconds = np.arange(0.0, 7.2, 0.3)
    return Trajectory(np.column_stack([-4.1 + 1.37 * seconds, 0.2 * np.sin(1.3 * seconds)]), 0.3, "a walk")


@pytest.mark.parametrize("scale", [1.0, 3.0])
@pytest.mark.parametrize("multiplier", [0.75, 1.3])
@pytest.mark.parametrize("scenario", ["crossing", "citr_crossing"])
def test_compiled_crossings_are_episodes_to_the_bit(scale, multiplier, scenario, safe):
    plan = replace(PLAN, scenario=load_scenario(scenario), multiplier=multiplier)
    here = crossing_plan(safe if scenario == "crossing" else (recorded(), *safe[:1]), plan)
    crossings = crude_crossings(here, 60)
    compiled = KnownCar(here).run_drawn(crossings, draws_of(here, crossings), scale)
    episodes = AnyCar(here, InProcessRunner(1))
    whole = episodes.run(crossings, scale)
    np.testing.assert_array_equal(compiled.touch, whole.touch)
    np.testing.assert_allclose(compiled.missed, whole.missed, atol=1e-9)
    np.testing.assert_array_equal(compiled.ticks, whole.ticks)
    assert (compiled.touch == Touch.FRONT).any()
    np.testing.assert_array_equal(compiled.touch == Touch.FRONT, compiled.missed == 0.0)


def simulated(here: CrossingPlan, car: KnownCar | Gauss, scale: float, effort: SubsetEffort) -> Subsets:
    levels = levels_of(here, car, scale, effort)
    numbers = range(effort.replicates)
    return gathered([replicate(here, car, scale, effort, levels, number) for number in numbers], effort)


class Gauss:
    """A car that hits where one of the walker's normals is above a bound: the probability is known."""

    car_normals = 0

    def __init__(self, bound: float, normal: int = 0) -> None:
        self.bound, self.normal, self.run_so_far = bound, normal, 0

    def run(self, crossings: Crossings, scale: float) -> Ends:
        self.run_so_far += len(crossings)
        missed = np.maximum(self.bound - scale * crossings.walker[:, self.normal], 0.0)
        return Ends(np.where(missed == 0.0, int(Touch.FRONT), int(Touch.NONE)), missed)


@pytest.mark.parametrize(
    ("bound", "scale", "normal"), [(2.0, 1.0, 0), (3.7, 1.0, 0), (4.3, 1.0, 0), (7.4, 2.0, 0), (3.7, 1.0, 40)]
)
def test_subset_simulation_gives_probabilities_that_are_known(bound, scale, normal, safe):
    """Of a car that hangs on one normal, be it the person's or of a tick, which moves of some of them seldom change."""
    car, here = Gauss(bound, normal), crossing_plan(safe)
    found = simulated(here, car, scale, SubsetEffort())
    truth = float(special.ndtr(-bound / scale))
    risk = ScaleRisk(scale, np.zeros(3, np.int64), 3, found)
    error = float(np.std(found.estimates, ddof=1)) / math.sqrt(len(found.estimates))
    assert error < 0.25 * truth
    assert abs(risk.value - truth) < 3.0 * error
    low, high = risk.ci95
    assert low / 1.15 <= truth <= 1.15 * high
    assert car.run_so_far == found.episodes
    np.testing.assert_allclose(found.shares.sum(axis=0), risk.value * 16 / 3, rtol=0.5)  # φ does not matter here


def test_what_is_never_hit_is_said_to_be_below_what_can_be_told(safe):
    effort = SubsetEffort(replicates=2, per_level=400, levels=3)
    found = simulated(crossing_plan(safe), Gauss(30.0), 1.0, effort)
    assert found.open_levels == 2
    risk = ScaleRisk(1.0, np.zeros(9, np.int64), 3, found)
    assert risk.value == 0.0
    assert risk.ci95 == (0.0, pytest.approx(0.1**2))
    assert "2 of them without a hit" in risk.method


def test_subset_simulation_agrees_with_crude_runs_of_a_car(safe):
    here = crossing_plan(safe, replace(PLAN, multiplier=1.35))
    car, rng = KnownCar(here), np.random.default_rng(2)
    count = 40_000
    normals = [rng.standard_normal((count, numbers)) for numbers in (here.walker_normals, car.car_normals)]
    crude = car.run(Crossings(np.arange(count) % 3, *normals, np.zeros(count, np.int64)), 2.0)
    hits = int((crude.touch == Touch.FRONT).sum())
    assert hits > 50
    found = simulated(here, car, 2.0, SubsetEffort())
    risk = ScaleRisk(2.0, np.zeros(3, np.int64), 3, found)
    apart = abs(risk.value - hits / count)
    error = math.hypot(math.sqrt(hits) / count, float(np.std(found.estimates)) / 4.0)
    assert apart < 3.0 * error
    assert apart < 0.1 * risk.value + 3.0 * math.sqrt(hits) / count


@pytest.fixture(scope="module")
def ratings(safe) -> dict[str, Assessment]:
    plans = {"basic": replace(PLAN, multiplier=1.5), "carla": replace(PLAN, controller="carla")}
    with InProcessRunner(1) as runner:
        return {name: rate(plan, [Objective.DEVIATION], list(safe), runner) for name, plan in plans.items()}


@pytest.mark.parametrize("name", ["basic", "carla"])
def test_the_number_of_workers_changes_nothing(name, ratings, monkeypatch):
    small = SubsetEffort(replicates=4, per_level=200, levels=4)
    monkeypatch.setattr("skd_evaluator.assessment.stages.risk.SubsetEffort", lambda: small)
    asked = RiskRequest(WALKERS, runs=RUNS if name == "basic" else 6)
    found = []
    for workers in (1, 2):
        with InProcessRunner(workers) as runner:
            found.append(with_risks(ratings[name], asked, runner))
    one, two = (rating.risks for rating in found)
    assert json.dumps(one.as_dict()) == json.dumps(two.as_dict())
    for mine, theirs in zip(one.scales, two.scales, strict=True):
        assert mine.touches.tobytes() == theirs.touches.tobytes()
        assert (mine.subsets is None) == (theirs.subsets is None) == (name == "carla")
        if mine.subsets is not None and theirs.subsets is not None:
            assert mine.subsets.shares.tobytes() == theirs.subsets.shares.tobytes()


def test_a_risk_of_whose_subset_simulation_crossings_are_aborted_is_none(ratings, monkeypatch):
    """They counted as misses: of the crude crossings, which come first, none is aborted here."""
    small = SubsetEffort(replicates=2, per_level=20, levels=2)
    monkeypatch.setattr("skd_evaluator.assessment.stages.risk.SubsetEffort", lambda: small)

    class Quitter(InProcessRunner):
        def run(self, episodes):
            for log in super().run(episodes):
                crude = split_episode_id(log.episode.episode_id)[2] < 1 << 31
                yield log if crude else replace(log, outcome=Outcome.ABORTED, reason="process ended: it did")

    with Quitter(1) as runner:
        found = with_risks(ratings["carla"], RiskRequest(WALKERS, runs=6, subset=True), runner)
    assert [(one.value, one.lost, one.runs) for one in found.risks.scales] == [(None, 20, 6)] * 3
    assert found.as_dict()["risk_1"] is None
    assert found.risk_note == ""


def test_aborted_runs_are_none():
    touches = np.array([Touch.FRONT, Touch.ABORTED, Touch.NONE, Touch.ABORTED], np.int64)
    assert ScaleRisk(1.0, touches, 2).value == 0.5
    nothing = ScaleRisk(1.0, np.full(4, int(Touch.ABORTED)), 2)
    assert (nothing.value, nothing.ci95) == (None, None)


def test_the_interval_of_replicates_is_students_on_the_logarithm():
    estimates = np.array([1e-5, 2e-5, 3e-5, 2e-5])
    low, high = log_t_interval(estimates)
    reach = stats.t.ppf(0.975, 3) * stats.sem(estimates) / estimates.mean()
    assert (math.log(low / 2e-5), math.log(high / 2e-5)) == pytest.approx((-reach, reach))


def test_the_command_reports_it_and_leaves_everything_else_alone(skd_here, here):
    found = {}
    for name in ("walkers", "none"):
        done = skd_here("assess", *SMALL, "--behaviour", name, "--out", name)
        assert done.returncode == 0, done.stderr
        found[name] = json.loads((here / name / "assessment.json").read_text())
        verified = skd_here("verify", name)
        assert verified.returncode == 0, verified.stdout + verified.stderr
    assert found["walkers"]["risk"]["behaviour"]["name"] == "walkers"
    assert [one["runs"] for one in found["walkers"]["risk"]["scales"]] == [12] * 3
    assert found["none"]["risk"] is None
    assert "--behaviour none" in found["none"]["risk_note"]
    for key in found["none"]:
        if not key.startswith("risk") and key not in ("seconds", "provenance"):
            assert found["none"][key] == found["walkers"][key], key
    with np.load(here / "none" / "episodes.npz") as without, np.load(here / "walkers" / "episodes.npz") as both:
        assert {name for name in both.files if not name.startswith("risk_")} == set(without.files)
        for name in without.files:
            np.testing.assert_array_equal(without[name], both[name])


FOOTPRINT, RADIUS, HIT_SPEED = (2.25, 2.25, 0.9), 0.25, 0.556
FRONT, ELSEWHERE, NO_HIT = 1, 2, 3


@pytest.mark.parametrize(
    ("footprint", "place", "counts"),
    [
        ((2.25, 2.25, 0.9), (0.3, 2.5), FRONT),
        ((2.25, 2.25, 0.9), (1.1, 2.4), FRONT),  # 0.25 from a corner
        ((2.25, 2.25, 0.9), (1.15, 2.2), ELSEWHERE),
        ((2.25, 2.25, 0.9), (0.3, -2.5), ELSEWHERE),
        ((3.5, 1.0, 0.9), (1.1, 3.65), FRONT),
    ],
)
@pytest.mark.parametrize(("impact", "hits"), [(5.0, True), (HIT_SPEED, True), (0.999 * HIT_SPEED, False)])
def test_a_touch_counts_by_its_side_and_by_the_speed(footprint, place, counts, impact, hits):
    right, ahead = place
    for same in (SAME, IN_A_CURVE):
        found = side_touched(ahead, -right, footprint, RADIUS, impact, HIT_SPEED, same)
        assert found == (counts if hits else NO_HIT)


@pytest.mark.parametrize(
    ("ahead", "left", "exactly", "in_a_curve"),
    [
        (2.2, 1.1499, FRONT, ELSEWHERE),  # nothing but a side is there, a tenth of a millimetre off
        (2.2, -1.1499, FRONT, ELSEWHERE),
        (2.26, 1.1499, FRONT, FRONT),  # at a corner
        (2.2, 1.13, FRONT, FRONT),  # too deep to have just touched a side
        (2.26, 1.15, ELSEWHERE, ELSEWHERE),
    ],
)
def test_in_a_curve_who_is_not_ahead_of_the_front_touches_a_side(ahead, left, exactly, in_a_curve):
    for same, wanted in ((SAME, exactly), (IN_A_CURVE, in_a_curve)):
        assert side_touched(ahead, left, FOOTPRINT, RADIUS, 5.0, HIT_SPEED, same) == wanted


# --- The most likely failures: why they happen, how near they are to how people walk, and that none can be made up.


SHORT = Plan(
    load_scenario("crossing"), safe_count=3, kamikaze_count=2, collision_runs=8, seed=5, simulations=20, multiplier=0.8
)
TICK = 0.3
ASKED = RiskRequest(WALKERS, runs=60)


@pytest.fixture(scope="module")
def rated() -> Assessment:
    with InProcessRunner(1) as runner:
        return rate(SHORT, [Objective.DEVIATION], safe_trajectories(SHORT, runner), runner)


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
    return Walkers(SHORT.scenario, [np.column_stack([x, np.zeros(x.size)])], 5, WALKERS.values)


def normals(**of: float) -> np.ndarray:
    """Normals of a walker: those of the person by name, of every tick by name and `_ticks`, all others 0."""
    zero = np.zeros(normals_of(SHORT.scenario.ticks))
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


def risk(scale: float, hits: int, runs: int = 60) -> ScaleRisk:
    touches = np.array([Touch.FRONT] * hits + [Touch.NONE] * (runs - hits), np.int64)
    return ScaleRisk(scale, touches, 3, ticks=np.full(runs, 5))


@pytest.mark.parametrize(
    ("hits", "scale"), [((0, 0, 0), None), ((10, 30, 40), 1.0), ((9, 30, 40), 2.0), ((2, 5, 5), 2.0), ((1, 0, 0), 1.0)]
)
def test_failures_are_of_the_least_scale_that_has_enough(hits, scale, found):
    scales = [risk(one, count) for one, count in zip((1.0, 2.0, 3.0), hits, strict=True)]
    plan, ways = found.plan, [one.positions for one in found.safe]
    here = failures_of(scales, Walkers(plan.scenario, ways, plan.seed, WALKERS.values))
    assert (None if here is None else here.scale) == scale
    if here is not None:
        assert here.looked_at == here.hits == sum(one.hits for one in here.kinds)


def test_one_is_read_back_and_repeated_to_the_bit(folder):
    (subject,) = read_subjects([folder])
    kept = kept_failures(subject.figures)
    assert len(kept) == len(subject.failing) > 3
    for number, one in enumerate(kept):
        words = repeat_crossing(subject.figures, int(subject.failing.episode_id[number]))
        of = dict(zip(words[2::2], words[3::2], strict=True))
        assert (of["--mode"], of["--behaviour"], float(of["--scale"])) == ("risk", "walkers", one.scale)
        numbers = int(of["--safe-number"]), int(of["--trial"]), float(of["--scale"])
        log = run_episode(single_crossing(SHORT, WALKERS, *numbers))
        assert log.hit
        np.testing.assert_array_equal(log.adversary, subject.failing.adversary[number])
        np.testing.assert_array_equal(log.car, subject.failing.car[number])
        assert log.impact_time == subject.failing.impact_time[number]
