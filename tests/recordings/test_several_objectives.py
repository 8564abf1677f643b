"""Recordings of a campaign with kamikazes of two objectives, which share ids, draws and the runs along φ."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from bag_forge import Sent, campaign_messages
from common import assert_same_episodes, assert_valid
from recordings_support import crossing, trials
from skd_evaluator.assessment.assessment import Assessment, assessment_of
from skd_evaluator.assessment.files.results import write_assessment
from skd_evaluator.assessment.objective_result import kamikaze_set
from skd_evaluator.assessment.plan import Plan, split_episode_id
from skd_sim.options.adversary import DEFAULT_OBJECTIVES, Objective
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.episode import EpisodeLog, Mode

Write = Callable[..., Path]
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
        objective: [kamikaze_set(phi, [log for log in logs if _is_of(log, index)]) for index, phi in enumerate(SAFE)]
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


def test_a_recording_of_both_gives_the_same_assessment(
    live: Assessment, messages: Sequence[Sequence[Sent]], recorded: Write, replay: Callable[..., Any], tmp_path: Path
) -> None:
    done = replay(recorded(messages))
    assert (done.code, done.err) == (0, "")
    assert_valid(done.result)
    assert figures(done.result) == figures(json.loads(json.dumps(live.as_dict())))
    assert list(done.result["objectives"]) == ["deviation", "paper"]
    write_assessment(tmp_path, live)
    assert_same_episodes((tmp_path / "episodes.npz").read_bytes(), done.episodes)
    # The same episodes share all draws, and yet no one is taken for another's double.
    assert done.result["warnings"] == []


def test_what_is_missing_is_said_with_its_objective(
    by_objective: dict[Objective, list[EpisodeLog]],
    messages: Sequence[Sequence[Sent]],
    recorded: Write,
    replay: Callable[..., Any],
) -> None:
    logs = [log for of_one in by_objective.values() for log in of_one]
    lost = next(k for k, log in enumerate(logs) if log.episode.objective == "paper" and _is_of(log, 1))
    done = replay(recorded([one for k, one in enumerate(messages) if k != lost]))
    assert done.code == 0
    said = "\n".join(done.result["warnings"])
    assert "no recording has kamikaze trials of objective paper 0 of safe trajectory 1" in said
    assert "of objective deviation" not in said
