"""Campaigns whose rows, cells or names were changed."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from cli_support import one_line
from edited_results import edit
from skd_evaluator.assessment.files.verification import verify

CAMPAIGN = """
cars: [{controller: basic, sweep: {multiplier: [0.5, 1.0]}}]
defaults: {safe_count: 2, kamikaze_count: 2, collision_runs: 4, simulations: 20}
"""


# --- campaigns


@pytest.fixture
def campaign(here: Path, skd_here) -> Path:
    (here / "cars.yaml").write_text(CAMPAIGN)
    done = skd_here("campaign", "cars.yaml", "--out", "out", "--workers", "1")
    assert done.returncode == 0, done.stderr
    return here / "out"


RESUME = ("campaign", "cars.yaml", "--out", "out", "--workers", "1", "--resume")


def test_rows_of_a_campaign_are_made_from_its_cells(campaign, skd_here):
    written, table = (campaign / "campaign.json").read_text(), (campaign / "campaign.csv").read_text()
    content = json.loads(written)
    for row in content["cells"]:
        row.update(deviation=4.9, margin=4.9, skd_ci95=[1, 2], problems=["none"], warnings=["none"], episodes=10**6)
    (campaign / "campaign.json").write_text(json.dumps(content))
    assert skd_here(*RESUME).returncode == 0
    again = json.loads((campaign / "campaign.json").read_text())
    assert again["cells"] == json.loads(written)["cells"]
    assert again["episodes_run"] == 0
    assert (campaign / "campaign.csv").read_text() == table
    assert skd_here("verify", "out").returncode == 0


def test_verify_holds_the_rows_of_a_campaign_against_its_cells(campaign):
    assert verify(campaign).fine
    cell = next(campaign.glob("*/assessment.json")).parent
    edit(cell, lambda figures: figures.update(seconds=1), "rewritten")
    (problem,) = verify(campaign).problems
    assert f"cell {cell.name}: assessment.json is not the file that the row is of" in problem


def test_cells_that_are_not_what_was_written_are_refused(campaign, skd_here):
    cells = sorted(path.parent for path in campaign.glob("*/assessment.json"))
    edit(cells[0], lambda figures: figures.update(skd=9.9))
    one_line(skd_here(*RESUME), 2, "assessment.json: is not what was written", "--resume makes it again")
    (cells[0] / "manifest.sha256").unlink()
    one_line(skd_here(*RESUME), 2, "has no manifest.sha256", "--resume makes it again")
    shutil.rmtree(cells[0])
    shutil.copytree(cells[1], cells[0])
    one_line(skd_here(*RESUME), 2, "is the result of another cell")
    shutil.rmtree(cells[0])
    assert skd_here(*RESUME).returncode == 0
