"""Recordings of campaigns: two objectives, a learned car, episodes that are missing, and what is said of them."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from bag_forge import Sent, campaign_messages, write_mcap
from common import assert_same_episodes, assert_valid, run_skd
from hypothesis import given
from hypothesis import strategies as st
from recordings_support import crossing, trials
from skd_adversary.adversary import any_car_models
from skd_adversary.car_models.car_model_file import car_model_text, fitted_car
from skd_evaluator.assessment.assessment import Assessment, KamikazeSet, assessment_of
from skd_evaluator.assessment.files.results import write_assessment
from skd_evaluator.assessment.plan import EpisodeGroup, Plan, episode_id, split_episode_id
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.assessment.stages.car_model import own_trials
from skd_evaluator.bags.checks import missing_episodes
from skd_evaluator.ros.recording import bag_name
from skd_sim import EpisodeLog, EpisodeSpec, Mode, load_scenario
from skd_sim.options.car_and_adversary import DEFAULT_OBJECTIVES, AdversaryModel, Objective

PLAN = Plan(load_scenario("crossing"), multiplier=1.1, simulations=3, seed=2)
SAFE = [crossing(0.75, 10, "brisk"), crossing(0.6, 13, "slow")]


@pytest.fixture(scope="module")
def by_objective() -> dict[Objective, list[EpisodeLog]]:
    """The runs along φ are with the first."""
    return {
        objective: trials(replace(PLAN, objective=objective), SAFE, 3, 4 if objective == DEFAULT_OBJECTIVES[0] else 0)
        for objective in DEFAULT_OBJECTIVES
    }


@pytest.fixture(scope="module")
def messages(by_objective: dict[Objective, list[EpisodeLog]]) -> list[list[Sent]]:
    return campaign_messages([log for logs in by_objective.values() for log in logs])


@pytest.fixture(scope="module")
def live(by_objective: dict[Objective, list[EpisodeLog]]) -> Assessment:
    sets = {
        objective: [KamikazeSet(phi, tuple(log for log in logs if _is_of(log, k))) for k, phi in enumerate(SAFE)]
        for objective, logs in by_objective.items()
    }
    replays = [log for logs in by_objective.values() for log in logs if log.episode.mode == Mode.REPLAY]
    return assessment_of(PLAN, SAFE, sets, replays)


def _is_of(log: EpisodeLog, index: int) -> bool:
    return log.episode.mode == Mode.KAMIKAZE and split_episode_id(log.episode.episode_id)[1] == index


def figures(result: dict[str, Any]) -> dict[str, Any]:
    """All that follows from the episodes: not the margin, which is computed after them."""
    others = ("seconds", "safe", "version", "provenance", "vulnerability_curve")
    of_margin = ("margin", "optimality_gap", "impact_speed", "equivalent_multiplier")
    return {name: value for name, value in result.items() if name not in others and not name.startswith(of_margin)}


def test_a_recording_of_both_gives_the_same_assessment(live, messages, recorded, replay, tmp_path: Path) -> None:
    done = replay(recorded(messages))
    assert (done.code, done.err) == (0, "")
    assert_valid(done.result)
    assert figures(done.result) == figures(json.loads(json.dumps(live.as_dict())))
    assert list(done.result["objectives"]) == ["deviation", "paper"]
    write_assessment(tmp_path, live)
    assert_same_episodes((tmp_path / "episodes.npz").read_bytes(), done.episodes)
    # The same episodes share all draws, and yet no one is taken for another's double.
    assert done.result["warnings"] == []


def test_what_is_missing_is_said_with_its_objective(by_objective, messages, recorded, replay) -> None:
    logs = [log for of_one in by_objective.values() for log in of_one]
    lost = next(k for k, log in enumerate(logs) if log.episode.objective == "paper" and _is_of(log, 1))
    done = replay(recorded([one for k, one in enumerate(messages) if k != lost]))
    assert done.code == 0
    said = "\n".join(done.result["warnings"])
    assert "no recording has kamikaze trials of objective paper 0 of safe trajectory 1" in said
    assert "of objective deviation" not in said
    fewer = [one for one in logs if not (one.episode.objective == "paper" and _is_of(one, 0))]
    fewer += [one for one in by_objective[Objective.PAPER] if _is_of(one, 0)][:-1]
    said = "\n".join(replay(recorded(campaign_messages(fewer), "fewer")).result["warnings"])
    assert "the last kamikaze trials of objective paper of safe trajectory 0 were not recorded" in said


CAR = fitted_car(any_car_models()[0])


def _trials(log: EpisodeLog) -> list[EpisodeSpec]:
    """Kamikazes of one id that wait in two ways."""
    plan = Plan(load_scenario("crossing"), multiplier=1.1, simulations=3, seed=2)
    phi = log.episode.safe_trajectory
    assert phi is not None
    models = [car_model_text(replace(CAR, waiting_reward=reward)) for reward in (-0.1, -0.4)]
    how = {"begin": 100, "objectives": (Objective.DEVIATION,)}
    return [one for model in models for one in own_trials(plan, model, [phi], 2, **how)]


def test_each_has_a_bag_of_its_own(logs: list[EpisodeLog]) -> None:
    trials = _trials(logs[0])
    assert trials[0].episode_id == trials[2].episode_id == episode_id(EpisodeGroup.LEARNING, 0, 100)
    episodes = [*trials, *(log.episode for log in logs)]
    assert len({bag_name(one) for one in episodes}) == len(episodes)


def test_they_are_no_contradiction(logs, replay, recorded):
    """And none of them counts: the figures are those of the campaign alone."""
    alone = replay(recorded(campaign_messages(logs)))
    learned = replay(recorded(campaign_messages([*map(run_episode, _trials(logs[0])), *logs])))
    assert (alone.code, learned.code) == (0, 0), learned.err
    assert learned.episodes == alone.episodes


def test_a_search_that_found_no_hit_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Where a hit would begin at 30 m/s there is none: the margin stands at η_max, for nothing was found."""
    scenario = load_scenario("crossing")
    scenario = replace(scenario, collision=replace(scenario.collision, hit_speed=30.0))
    plan = Plan(scenario, controller="carla", adversary_model=AdversaryModel.GENERIC, simulations=1, seed=2)
    logs = trials(plan, [crossing(0.75, 10, "brisk")], 1, 2)
    messages = [one for each in campaign_messages(logs) for one in each]
    write_mcap(tmp_path / "recorded.mcap", messages, checksums=False)
    run_skd("replay", tmp_path / "recorded.mcap", "--margin-limit", 64, "--out", tmp_path / "out")
    printed = capsys.readouterr()
    assert "No hit found within 5 m" in printed.out
    said = printed.err.splitlines()
    assert sum("without checksums" in line for line in said) == 1


_numbered = st.sets(st.tuples(st.integers(0, 3), st.integers(0, 4)), max_size=8)


@given(_numbered)
def test_runs_are_missing_where_a_full_campaign_would_have_them(runs: set[tuple[int, int]]) -> None:
    """Said just where the runs are not all that some campaign has, which deals them out in turns."""
    announced = [episode_id(EpisodeGroup.NOMINAL, index, run) for index, run in runs]
    lines = missing_episodes(announced, {}, requested=1, left_out=False)
    safe = max((index for index, _ in runs), default=-1) + 1
    dealt = {(number % safe, number // safe) for number in range(len(runs))} if safe else set()
    assert bool(lines) == (runs != dealt)
