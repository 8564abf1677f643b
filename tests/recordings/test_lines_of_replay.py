"""`skd replay` prints what makes its figures doubtful, whichever step found it, and each line once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from bag_forge import campaign_messages, write_mcap
from common import run_skd
from recordings_support import crossing, trials
from skd_evaluator.assessment.plan import Plan
from skd_sim.options.adversary import AdversaryModel
from skd_sim.scenario.scenario import load_scenario


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
