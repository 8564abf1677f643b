"""Results of settings that few use: what an honest car has in them follows from its episodes, and is not in doubt."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from common import run_skd
from skd_evaluator.measure.doubt import in_doubt

SMALL = (
    *("--knowledge", "nothing", "--safe-count", 2, "--kamikaze-count", 2, "--collision-runs", 2, "--simulations", 20),
    *("--workers", 1, "--behaviour", "none", "--no-pictures", "--quiet", "--seed", 1),
)


@pytest.mark.parametrize("scenario", ["crossing", "cyclist"])
def test_drawn_actions_are_among_what_their_road_user_can_do(
    scenario: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drawn = ("--actions", "drawn", "--margin-limit", 0, "--scenario", scenario)
    assert run_skd("assess", *drawn, *SMALL, "--out", tmp_path / "drawn") == 0
    assert run_skd("verify", tmp_path / "drawn") == 0, capsys.readouterr().out
    # Whoever says that they were listed, is contradicted by their episodes.
    summary = tmp_path / "drawn" / "assessment.json"
    figures = json.loads(summary.read_text())
    assert figures["options"].pop("actions") == "drawn"
    summary.write_text(json.dumps(figures))
    (tmp_path / "drawn" / "manifest.sha256").unlink()
    assert run_skd("verify", tmp_path / "drawn") == 1
    assert "does not follow from its other states" in capsys.readouterr().out


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
