"""The graph gives what the plain loop gives, to the last bit."""

from __future__ import annotations

import json
import uuid
from pathlib import Path

import pytest
from graph_support import (
    MULTIPLIERS,
    Campaign,
    assert_all_gone,
    assert_same_log,
    assert_same_results,
    in_domain,
    new_domain,
)
from skd_evaluator.campaign import Plan, safe_trajectories, single_episode
from skd_evaluator.graph.options import GraphOptions
from skd_evaluator.graph.session import graph_session
from skd_evaluator.runner import run_episode
from skd_evaluator.workers import InProcessRunner
from skd_sim.episode import Episode, Mode, Outcome
from skd_sim.scenario import load_scenario


def episodes(name: str) -> list[Episode]:
    """Four attempts of each mode at each of three multipliers."""
    scenario = load_scenario(name)
    safe = safe_trajectories(Plan(scenario, safe_count=1, seed=11), InProcessRunner(1))[0]
    return [
        single_episode(Plan(scenario, multiplier=multiplier, seed=11, simulations=500), mode, attempt, safe)
        for multiplier in MULTIPLIERS
        for mode in Mode
        for attempt in range(4)
    ]


@pytest.mark.parametrize("scenario", ["crossing", "crossing_multi_body"])
def test_episodes_are_the_same_to_the_last_bit(tmp_path: Path, scenario: str) -> None:
    wanted = episodes(scenario)
    assert len(wanted) >= 20
    expected = [run_episode(episode) for episode in wanted]
    token = uuid.uuid4().hex
    with (
        in_domain(new_domain(), token),
        graph_session(
            GraphOptions(), controller="basic", campaign="test", log_folder=tmp_path, record_to=None
        ) as evaluator,
    ):
        logs = list(evaluator.run(wanted))
    assert_all_gone(token)
    for one, other in zip(expected, logs, strict=True):
        assert_same_log(one, other)
    assert {log.outcome for log in logs} >= {Outcome.COLLISION, Outcome.ARRIVED}


@pytest.mark.parametrize("multiplier", MULTIPLIERS)
def test_assessments_are_the_same_to_the_last_bit(campaigns: dict[float, Campaign], multiplier: float) -> None:
    campaign = campaigns[multiplier]
    assert_same_results(campaign.graph, campaign.in_process)
    one, other = (
        json.loads((folder / "assessment.json").read_text()) for folder in (campaign.graph, campaign.in_process)
    )
    assert one["skd"] is not None
    assert {key for key in one if one[key] != other[key]} <= {"seconds"}
