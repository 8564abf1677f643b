"""Kamikazes that were not planned as is said are found; those of which nobody can tell are counted."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_forge import campaign_messages
from common import assert_valid, run_skd
from recordings_support import attempts, crossing
from skd_adversary.adversary import make_adversary
from skd_adversary.warm_up import any_car_models
from skd_evaluator.bags.validation import Otherwise, Unverified, decide_again, examine
from skd_evaluator.bags.verification import Sample
from skd_evaluator.campaign.judge.rating import judge_all
from skd_evaluator.campaign.plan.plan import Plan, kamikaze_set
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.campaign.store.manifest import write_manifests
from skd_evaluator.campaign.store.results import write_assessment
from skd_sim.choices.actions import Actions
from skd_sim.choices.knowledge import Knowledge
from skd_sim.choices.objective import Objective
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.command_ages import Timing
from skd_sim.episode.episode import EpisodeLog, Mode
from skd_sim.geometry.trajectory import Trajectory
from skd_sim.state import CarState

Write = Callable[..., Path]
FORGERIES: dict[str, dict[str, Any]] = {
    "simulations": {"simulations": 1000},
    "particles": {"particles": 400},
    "objective": {"objective": Objective.DEFORMATION},
    "knowledge": {"knowledge": Knowledge.NOTHING},
    "car model": {"knowledge": None, "car_model": any_car_models()[0]},
}
REAL_TIME = Timing((0.01,), 1, 0.002)


def kamikazes(logs: Sequence[EpisodeLog]) -> list[EpisodeLog]:
    return [log for log in logs if log.episode.mode == Mode.KAMIKAZE]


def said(logs: Sequence[EpisodeLog], **otherwise: Any) -> list[EpisodeLog]:
    """Logs that say something else of what they were planned with."""
    return [replace(log, episode=replace(log.episode, **otherwise)) for log in logs]


@dataclass
class Ended:
    """A command, at its end."""

    code: int
    err: str
    result: dict[str, Any]


@pytest.fixture
def verify(recorded: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., Ended]:
    """Record logs and run `skd replay --verify` on them."""

    def run(logs: Sequence[EpisodeLog], *arguments: object) -> Ended:
        bag, out = recorded(campaign_messages(logs)), tmp_path / "out"
        capsys.readouterr()
        code = run_skd("replay", bag, "--out", out, "--overwrite", "--json", "-q", "--verify", *arguments)
        said = capsys.readouterr()
        return Ended(code, said.err, json.loads(said.out))

    return run


def test_what_was_planned_as_it_says_is_verified(
    logs: list[EpisodeLog], verify: Callable[..., Ended], tmp_path: Path
) -> None:
    count = len(kamikazes(logs))
    done = verify(logs)
    assert (done.code, done.result["warnings"]) == (0, [])
    assert done.err.splitlines() == [
        f"skd replay: decisions of {count} of {count} kamikazes made again: {count} planned as is said"
    ]
    found = done.result["verification"]
    assert (found["kamikazes"], found["drawn"], found["verified"]) == (count, count, count)
    assert (found["not_verifiable"], found["not_as_planned"]) == ({}, [])
    assert_valid(done.result)
    assert run_skd("verify", tmp_path / "out", "--decisions") == 0


@pytest.mark.parametrize("what", FORGERIES)
def test_a_campaign_that_says_another_planner_than_it_had(
    logs: list[EpisodeLog], verify: Callable[..., Ended], what: str
) -> None:
    """Without --verify nothing is noticed: every step is one that an adversary can choose."""
    done = verify(said(logs, **FORGERIES[what]))
    found = done.result["verification"]
    assert done.code == 1
    assert found["not_as_planned"]
    assert found["verified"] + len(found["not_as_planned"]) == found["drawn"]
    assert "do not believe these figures" in done.err
    assert_valid(done.result)


def test_a_single_kamikaze_that_was_planned_by_less(logs: list[EpisodeLog], verify: Callable[..., Ended]) -> None:
    """It is named, with the tick, what was recorded there and what the adversary would have done."""
    number, honest = 1, logs[1]
    forged = run_episode(replace(honest.episode, simulations=1))
    forged = replace(forged, episode=honest.episode)
    shared = min(len(honest.adversary), len(forged.adversary))
    tick = int(np.argmax((honest.adversary[:shared] != forged.adversary[:shared]).any(axis=1))) - 1
    assert tick >= 0  # else it is none of another planner
    done = verify([*logs[:number], forged, *logs[number + 1 :]])
    assert done.code == 1
    (found,) = done.result["verification"]["not_as_planned"]
    assert (found["episode_id"], found["objective"], found["tick"]) == (honest.episode.episode_id, "paper", tick)
    for name, log in (("recorded", forged), ("planned", honest)):
        velocity = (log.adversary[tick + 1] - log.adversary[tick]) / 0.3
        assert found[name] == pytest.approx(velocity.tolist(), abs=1e-9)
    assert any(str(honest.episode.episode_id) in line and f"at tick {tick} " in line for line in done.err.splitlines())


def test_a_share_of_them_is_drawn_by_a_seed_that_is_said(logs: list[EpisodeLog], verify: Callable[..., Ended]) -> None:
    done = verify(logs, 50, "--verify-seed", 7)
    count = len(kamikazes(logs))
    assert done.result["verification"]["drawn"] == -(-count // 2)
    assert done.result["verification"]["seed"] == 7
    assert "drawn by seed 7" in done.err
    drawn = [{log.episode.episode_id for log in Sample(0.5, seed).drawn(logs)} for seed in (7, 7, *range(20))]
    assert drawn[0] == drawn[1]
    assert set.union(*drawn) == {log.episode.episode_id for log in logs}
    assert len(Sample(0.001, 1).drawn(logs)) == 1
    assert len({Sample.of(1.0, None).seed for _ in range(3)}) == 3  # nobody knows beforehand which are drawn


def test_what_cannot_be_decided_again_is_counted(logs: list[EpisodeLog], verify: Callable[..., Ended]) -> None:
    copies = said(logs, knowledge=Knowledge.ITSELF)
    done = verify(copies)
    assert done.code == 0
    assert done.result["verification"]["verified"] == 0
    assert done.result["verification"]["not_verifiable"] == {str(Unverified.ITSELF): len(kamikazes(logs))}
    assert any("not verifiable (knowledge itself" in line for line in done.result["warnings"])


class Held:
    """An adversary whose commands come a tick late, as they may in real time."""

    depletions = 0

    def __init__(self, log: EpisodeLog) -> None:
        self._planner = make_adversary(log.episode)
        self._last: tuple[float, float] | None = None

    def act(self, car: CarState) -> tuple[float, float]:
        planned = self._planner.act(car)
        last, self._last = self._last or planned, planned
        return last


def test_real_time_obeys_commands_of_earlier_ticks(logs: list[EpisodeLog]) -> None:
    """They were planned all the same; what was never planned is found there, too, and lockstep is never late."""
    honest = kamikazes(logs)[0]
    late = run_episode(honest.episode, adversary=Held(honest))
    assert isinstance(decide_again(late), Otherwise)
    assert decide_again(replace(late, timing=REAL_TIME)) == Unverified.LATE
    assert decide_again(replace(honest, timing=REAL_TIME)) is None
    found = [decide_again(replace(log, timing=REAL_TIME)) for log in said(kamikazes(logs), simulations=700)]
    assert any(isinstance(one, Otherwise) for one in found)


def test_another_simulator_moves_the_adversary_its_own_way(logs: list[EpisodeLog]) -> None:
    honest = kamikazes(logs)[0]
    moved = honest.car.copy()
    moved[1:, 0] += 0.01
    assert decide_again(replace(honest, car=moved)) == Unverified.ELSEWHERE


def driven(plan: Plan, mode: Mode, attempt: int) -> EpisodeLog:
    """Someone's way in an encounter: a safe one, or one along that of the first attempt, or planned from it."""
    safe = run_episode(plan.episode(Mode.SAFE, 0, 0, None))
    phi = Trajectory(safe.adversary, plan.scenario.time_step, "safe")
    return run_episode(plan.episode(mode, 0, attempt, None if mode == Mode.SAFE else phi))


@pytest.mark.parametrize("actions", Actions)
@pytest.mark.parametrize("name", ["cyclist", "child", "ccftap", "right_turn", "oncoming_turn", "cbtafs", "bystanders"])
def test_whoever_crosses_on_whatever_road_other_decisions_are_found(name: str, actions: Actions) -> None:
    """States do not tell how a cyclist turned to the last bit; that is no reason to know nothing of its decisions."""
    plan = Plan(load_scenario(name), safe_count=1, simulations=20, seed=3, actions=actions)
    for mode in (Mode.SAFE, Mode.REPLAY):
        verdict = examine(driven(plan, mode, 1))
        assert (verdict.fault, verdict.rounded) == ("", 0.0), verdict.rounded_where
    honest = [driven(plan, Mode.KAMIKAZE, attempt) for attempt in range(3)]
    assert [decide_again(log) for log in honest] == [None] * len(honest)
    forged = [decide_again(log) for log in said(honest, simulations=11)]
    assert any(isinstance(one, Otherwise) for one in forged)
    assert all(one is None or isinstance(one, Otherwise) for one in forged)


@pytest.mark.parametrize("name", ["cyclist", "right_turn"])
def test_a_recording_that_rounds_otherwise_is_told_to(name: str) -> None:
    """Of such a one nobody can say what was decided, and it is said; places of the car tell, on turning roads, too."""
    plan = Plan(load_scenario(name), safe_count=1, simulations=20, seed=3)
    log = driven(plan, Mode.KAMIKAZE, 0)
    assert examine(log).rounded == 0.0
    tick = len(log.car) // 2
    for column in range(3):
        car = log.car.copy()
        car[tick, column] = np.nextafter(car[tick, column], np.inf)
        rounded = replace(log, car=car)
        verdict = examine(rounded)
        assert verdict.ours
        assert 0.0 < verdict.rounded < 1e-9
        forged = replace(rounded, episode=replace(log.episode, simulations=11))
        assert decide_again(forged) in {None, Unverified.ROUNDED}


def write_result(folder: Path, plan: Plan, logs: Sequence[EpisodeLog]) -> None:
    """An assessment of these logs, as `skd assess` leaves it."""
    phis = {log.episode.safe_trajectory: None for log in logs}
    sets = [
        kamikaze_set(phi, [log for log in kamikazes(logs) if log.episode.safe_trajectory is phi]) for phi in phis if phi
    ]
    replays = [log for log in logs if log.episode.mode == Mode.REPLAY]
    safe = [one.safe_trajectory for one in sets]
    folder.mkdir()
    write_assessment(folder, judge_all(plan, safe, {plan.objective: sets}, replays, 1.0))
    write_manifests(folder)


@pytest.mark.parametrize(
    "car",
    [
        {"multiplier": 1.1},
        {"particles": 31, "maximum_distance": 2.0, "objective": Objective.FRECHET},
        {"controller": "cal"},
        {"controller": "basic", "car_model": any_car_models()[0]},
        {"controller": "basic", "car_model": any_car_models()[1]},
    ],
)
def test_a_result_says_all_that_its_kamikazes_were_planned_with(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], car: dict[str, Any]
) -> None:
    plan = Plan(load_scenario("crossing"), safe_count=2, simulations=20, seed=3, **car)
    logs = attempts(plan, [crossing(0.75, 10, "brisk"), crossing(0.6, 13, "slow")], 2, 2)
    write_result(tmp_path / "result", plan, logs)

    def verified() -> tuple[int, dict[str, Any]]:
        capsys.readouterr()
        code = run_skd("verify", tmp_path / "result", "--decisions", "--json")
        (found,) = json.loads(capsys.readouterr().out)["results"]
        return code, found

    code, found = verified()
    assert (code, found["problems"]) == (0, [])
    assert found["decisions"]["verified"] == found["decisions"]["kamikazes"] == len(kamikazes(logs))
    path = tmp_path / "result" / "assessment.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"simulations": 21}))
    write_manifests(tmp_path / "result")
    assert run_skd("verify", tmp_path / "result") == 0
    code, found = verified()
    assert code == 1
    assert found["decisions"]["not_as_planned"]
    assert any("was not planned as is said" in line for line in found["problems"])
    path.write_text(json.dumps(json.loads(path.read_text()) | {"version": "0.0.1"}))
    write_manifests(tmp_path / "result")
    code, found = verified()
    assert found["decisions"]["not_verifiable"] == {str(Unverified.VERSION): len(kamikazes(logs))}
