"""Results of settings that few use: what an honest car has in them follows from its episodes, and is credible."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from common import run_skd
from skd_evaluator.metrics.aborted import not_credible

SMALL = (
    *("--adversary-model", "generic", "--safe-count", 2, "--kamikaze-count", 2, "--collision-runs", 2),
    *("--simulations", 20),
    *("--workers", 1, "--behaviour", "none", "--no-pictures", "--quiet", "--seed", 1),
)


def test_a_kamikaze_that_is_hit_beyond_eta_max_has_no_margin(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The search looks no further; it was said that the car answers it otherwise than an episode."""
    (tmp_path / "near.yaml").write_text("extends: crossing_multi_body\nname: near\neta_max: 0.3\n")
    searched = ("--multiplier", 1.5, "--objective", "paper", "--margin-limit", 32)
    scenario = ("--scenario", tmp_path / "near.yaml")
    assert run_skd("assess", *searched, *scenario, *SMALL, "--out", tmp_path / "near") == 0
    figures = json.loads((tmp_path / "near" / "assessment.json").read_text())
    assert figures["deviation_of_successes"] > figures["eta_max"] == figures["margin"] == 0.3
    assert figures["margin_beyond"] == figures["margin_trials"] == 4
    assert not_credible(figures["warnings"]) == []
    assert "give a greater --kamikaze-count or eta_max" in capsys.readouterr().err
    assert run_skd("verify", tmp_path / "near") == 0, capsys.readouterr().out
