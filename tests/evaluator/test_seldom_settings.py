"""Results of settings that few use: what an honest car has in them follows from its episodes, and is not in doubt."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from common import run_skd
from skd_evaluator.campaign.plan.plan import Plan
from skd_evaluator.campaign.store.stored_episodes import read_episodes
from skd_evaluator.margin.again import _walked
from skd_evaluator.measure.doubt import in_doubt
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.episode import Mode
from skd_sim.geometry.trajectory import Trajectory

SMALL = (
    *("--knowledge", "nothing", "--safe-count", 2, "--kamikaze-count", 2, "--collision-runs", 2, "--simulations", 20),
    *("--workers", 1, "--behaviour", "none", "--no-pictures", "--quiet", "--seed", 1),
)


def test_a_kamikaze_that_is_hit_beyond_eta_max_has_no_margin(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The search looks no further; it was said that the car answers it otherwise than an episode."""
    (tmp_path / "near.yaml").write_text("extends: crossing_multi_body\nname: near\neta_max: 0.3\n")
    searched = ("--multiplier", 1.5, "--objective", "paper", "--margin-limit", 512)
    encounter = ("--scenario", tmp_path / "near.yaml")
    assert run_skd("assess", *searched, *encounter, *SMALL, "--out", tmp_path / "near") == 0
    figures = json.loads((tmp_path / "near" / "assessment.json").read_text())
    assert figures["deformation_of_successes"] > figures["eta_max"] == figures["margin"] == 0.3
    assert figures["margin_beyond"] == figures["margin_attempts"] == 4
    assert in_doubt(figures["warnings"]) == []
    assert "or take more than η_max" in capsys.readouterr().err
    assert run_skd("verify", tmp_path / "near") == 0, capsys.readouterr().out


@pytest.mark.filterwarnings("error")
def test_a_cyclist_that_is_hit_as_it_turns_is_led_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Positions do not say which way it turned; it was led nowhere, and hit wherever it was."""
    (tmp_path / "narrow.yaml").write_text("extends: cyclist\nname: narrow\ncar: {width: 1.155}\n")
    planned = ("--safe", "own", "--objective", "paper", "--margin-limit", 512, "--scenario", tmp_path / "narrow.yaml")
    assert run_skd("assess", *planned, *SMALL, "--seed", 2703, "--out", tmp_path / "out") == 0
    turned = [
        (index, way)
        for index, ways in enumerate(read_episodes(tmp_path / "out").margin_ways)
        for way in ways
        if way.duration == len(way.positions) - 2
    ]
    assert turned
    assert run_skd("verify", tmp_path / "out") == 0, capsys.readouterr().out

    plan = Plan(load_scenario(str(tmp_path / "narrow.yaml")), seed=2703)
    index, way = turned[0]
    phi = Trajectory(read_episodes(tmp_path / "out").safe[index], 0.3, "")
    episode = plan.episode(Mode.KAMIKAZE, index, way.attempt, phi)
    assert list(_walked(episode, way)) == []
    elsewhere = replace(way, positions=np.vstack([way.positions[:1], way.positions[1:] - [4.0, 0.0]]))
    assert len(list(_walked(episode, elsewhere))) == 1
