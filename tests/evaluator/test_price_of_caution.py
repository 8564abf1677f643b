"""The price of caution: closed forms of its figures, and cars of which it is known."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from skd_evaluator.assessment.context import Context
from skd_evaluator.assessment.figure_table import columns
from skd_evaluator.assessment.options import GraphOptions
from skd_evaluator.assessment.plan import EpisodeGroup, Plan, split_episode_id
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.price import CLEAR, KINDS, price_of_caution, why_no_price
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.metrics.price_of_caution import (
    HORIZON,
    HarmlessRun,
    PriceOfCaution,
    does_not_get_past,
    stratified_interval,
)
from skd_evaluator.report.terminal import comparison_table, print_table
from skd_sim.scenario.road import right_and_along
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.world.episode import EpisodeLog, EpisodeSpec
from skd_sim.world.state import AdversaryState, CarState

COUNT = 20

CARS = Path(__file__).parents[2] / "examples" / "price_of_caution" / "cars.py"


class Recorded(InProcessRunner):
    def __init__(self) -> None:
        super().__init__(1)
        self.logs: list[EpisodeLog] = []

    def run(self, episodes: list[EpisodeSpec]) -> list[EpisodeLog]:  # type: ignore[override]
        found = list(super().run(episodes))
        self.logs += found
        return found


def price_of(controller: str, scenario: str = "crossing", runner: InProcessRunner | None = None) -> PriceOfCaution:
    controller = controller if ":" in controller else f"{CARS}:{controller}"
    plan = Plan(controller=controller, scenario=load_scenario(scenario), safe_count=5, seed=3)
    with runner or InProcessRunner(1) as running:
        running.start([])
        found = price_of_caution(plan, safe_trajectories(plan, running), running, COUNT)
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("car", "lost", "needless", "deadlock"),
    [
        ("NeverBrakes", 0.0, 0.0, 0.0),
        ("BrakesByTimeToCollision", 0.0, 0.0, 0.0),
        ("HalfSpeed", 0.0, 0.0, 0.0),
        ("BrakesForEverybody", 24.3, 1.0, 1.0),
    ],
)
def test_the_price_of_a_car_is_what_its_rule_says(car: str, lost: float, needless: float, deadlock: float) -> None:
    found = price_of(car)
    assert found.mean("time_lost") == pytest.approx(lost, abs=0.5 if lost else 0.0)
    assert (found.mean("needless"), found.mean("deadlock")) == (needless, deadlock)
    assert found.does_not_get_past == (deadlock == 1.0)
    assert found.mean("late") == pytest.approx(found.mean("time_lost") + found.mean("slow"))


def test_a_car_that_stops_for_who_is_far_behind_it_has_an_empty_road_too(tmp_path: Path) -> None:
    car = "class Car:\n    def reset(self, scenario, rng): pass\n    def command(self, car, adversary):\n"
    (tmp_path / "car.py").write_text(f"{car}        return -6.0 if adversary.y - car.y < -20.0 else 0.0\n")
    assert max(one.undisturbed for one in price_of(f"{tmp_path}/car.py:Car").runs) < 10.0


def test_half_speed_is_slow_by_as_much_as_the_way_takes_at_full_speed() -> None:
    found = price_of("HalfSpeed")
    at_full = np.mean([one.unslowed for one in found.runs])
    braking = (25 / 3 - 25 / 6) / 3.5 * 0.25  # of the way gained until it is at half speed, s of full speed
    assert found.mean("slow") == pytest.approx(at_full - braking, abs=0.4)


def test_a_car_that_stops_loses_time_beside_those_who_stand_near_its_lane_alone() -> None:
    found = price_of("StopsAndWaits")
    lost = {kind: [one.lost for one in found.runs if one.kind == kind] for kind in KINDS}
    assert min(lost["waits"]) > 1.0
    assert max(lost["goes away"]) == 0.0


@pytest.mark.parametrize("scenario", ["crossing", "cyclist", "child", "right_turn", "cpla"])
def test_who_crosses_is_clear_of_the_undisturbed_car(scenario: str) -> None:
    runner = Recorded()
    found = price_of("NeverBrakes", scenario, runner)
    assert not any(one.braked for one in found.runs)
    assert found.mean("time_lost") == pytest.approx(0.0, abs=1e-12)  # nobody was hit
    logs = [log for log in runner.logs if split_episode_id(log.episode.episode_id)[0] == EpisodeGroup.PRICE]
    undisturbed, harmless = logs[:COUNT], logs[COUNT:]
    for alone, log in zip(undisturbed, harmless, strict=True):
        assert np.array_equal(alone.car[: len(log.car)], log.car[: len(alone.car)])
        spec, step = log.episode.scenario, log.episode.scenario.time_step
        car = right_and_along(spec.road.line, np.ascontiguousarray(log.car[:, :2]))[:, 1]
        user = right_and_along(spec.road.line, log.adversary)
        inside = np.flatnonzero(np.abs(user[:, 0]) <= spec.path_edge)
        for tick in inside.tolist():
            ahead = car - user[tick, 1]
            near = np.flatnonzero((ahead > -spec.car.front) & (ahead < spec.car.rear))
            assert not near.size or np.abs(near - tick).min() * step > CLEAR - 2 * step


def test_where_phi_go_along_the_lane_nobody_crosses() -> None:
    assert {one.kind for one in price_of("NeverBrakes", "cpla").runs} == set(KINDS[:3])


def test_one_worker_or_two_give_the_same_price() -> None:
    assert price_of("StopsAndWaits") == price_of("StopsAndWaits", runner=InProcessRunner(2))


@pytest.mark.parametrize(
    ("scenario", "repeats", "said"), [("ccrs", True, "on foot, bicycle or scooter"), ("crossing", False, "in lockstep")]
)
def test_why_there_is_no_price(scenario: str, repeats: bool, said: str) -> None:
    assert said in why_no_price(Plan(scenario=load_scenario(scenario)), repeats=repeats)


@pytest.mark.parametrize(("how", "holds"), [({"quiet_time": 0.1}, True), ({"pacing": "real_time"}, True), ({}, False)])
def test_a_stack_that_does_not_answer_each_state_is_known_for_the_price_would_take_an_hour(how, holds) -> None:
    runner = InProcessRunner()
    assert Context(runner, runner, graph=GraphOptions(**how)).holds_commands is holds


def made(lost: list[float], kinds: list[str]) -> PriceOfCaution:
    return PriceOfCaution(tuple(HarmlessRun(k, 6.0 + x, 6.0, 5.5, x > 1.0) for x, k in zip(lost, kinds, strict=True)))


def test_the_interval_of_one_kind_is_students() -> None:
    values = [0.0, 1.0, 3.0, 4.0]
    expected = stats.t.interval(0.95, 3, loc=np.mean(values), scale=stats.sem(values))
    assert stratified_interval(["waits"] * 4, np.array(values)) == pytest.approx(expected)


@pytest.mark.parametrize("rate", [0.003, 0.02, 0.3])
def test_the_interval_of_the_time_lost_holds_the_mean_where_few_runs_never_pass(rate: float) -> None:
    """Of 60 runs that lose 0.5 s on average most see none that loses 24 s where these are rare."""
    rng, held = np.random.default_rng(3), 0
    for _ in range(1000):
        lost = np.where(rng.random(60) < rate, HORIZON - 6.0, rng.exponential(0.5, 60))
        found = made(lost.tolist(), list(KINDS) * 12)
        low, high = found.ci95("time_lost") or (math.nan, math.nan)
        assert low <= found.mean("time_lost") <= high
        held += low <= rate * (HORIZON - 6.0) + (1.0 - rate) * 0.5 <= high
    assert 0.93 <= held / 1000 <= 0.99


def test_kinds_that_differ_do_not_widen_the_interval() -> None:
    rng = np.random.default_rng(5)
    kinds = ["waits", "crosses before"] * 20
    noise = rng.normal(0.0, 1.0, 40)
    steps = noise + np.where(np.array(kinds) == "waits", 20.0, 0.0)
    narrow, same = stratified_interval(kinds, steps), stratified_interval(kinds, noise)
    assert narrow[1] - narrow[0] == pytest.approx(same[1] - same[0])


def test_intervals_of_the_time_lost_hold_the_mean() -> None:
    rng, kinds = np.random.default_rng(1), list(KINDS) * 12
    means, spread = np.arange(5.0), np.array([0.5, 3.0, 1.0, 0.2, 2.0])
    truth, held = float(means.mean()), 0
    for _ in range(2000):
        values = np.tile(means, 12) + np.tile(spread, 12) * (rng.exponential(1.0, 60) - 1.0)
        low, high = stratified_interval(kinds, values) or (math.nan, math.nan)
        held += low <= truth <= high
    assert 0.93 <= held / 2000 <= 0.97


def test_who_never_gets_past_counts_the_whole_horizon() -> None:
    runs = PriceOfCaution((HarmlessRun("waits", HORIZON, 6.0, 5.5, True),) * 10)
    assert tuple(map(runs.mean, ("time_lost", "deadlock", "slow"))) == (24.0, 1.0, 0.5)


class KeepsLeft:
    """Drives 1.5 m to the left of the middle of its lane, whoever is there."""

    steers_by = "curvature"

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Nothing is kept."""

    def command(self, car: CarState, adversary: AdversaryState) -> tuple[float, float]:
        return 0.0, 0.3 * (0.2 * min(1.0, max(-1.0, car.x + 1.5)) - (car.heading - math.pi / 2.0))


def test_how_long_a_car_is_out_of_its_lane_in_harmless_runs_is_known() -> None:
    found = price_of(f"{__file__}:KeepsLeft", "oncoming_lane")
    assert found.lanes_left is not None
    share, seconds = found.lanes_left
    assert share == 1.0
    driven = np.mean([one.passed for one in found.runs])
    assert 0.4 * driven < seconds <= driven + 0.3  # until it has passed
    assert price_of("NeverBrakes").lanes_left is None
    runs = tuple(HarmlessRun("waits", 6.0, 6.0, 5.5, False, time) for time in (0.0, 2.0, 0.0, 4.0))
    assert PriceOfCaution(runs).lanes_left == (0.5, 3.0)


def test_only_a_lower_end_above_five_percent_says_that_a_car_does_not_get_past() -> None:
    assert does_not_get_past({"deadlock_ci95": (0.06, 0.2)})
    assert not does_not_get_past({"deadlock_ci95": (0.04, 0.2)})
    assert not does_not_get_past({"deadlock_ci95": None})


def test_who_does_not_get_past_people_never_ranks_first(capsys: pytest.CaptureFixture[str]) -> None:
    row = dict.fromkeys(columns("compare"))
    cars = (("stuck", 4.9, (0.9, 1.0)), ("good", 1.2, (0.0, 0.1)), ("bad", 0.3, (0.0, 0.1)))
    rows = [{**row, "car": name, "margin": margin, "deadlock_ci95": ends} for name, margin, ends in cars]
    print_table(comparison_table(rows, "margin"))
    shown = capsys.readouterr().out
    assert shown.index("stuck, often stuck") < shown.index("bad ") < shown.index("good ")
