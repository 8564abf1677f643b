"""`skd campaign` over real graphs: whatever ends it leaves no process, and it goes on where it was."""

from __future__ import annotations

import json
import signal
from pathlib import Path

from common import wait_until
from graph_support import Skd, assert_same_results, skd
from skd_evaluator.assessment.files.episode_store import FILE_NAME

SIZES = {"safe_count": 1, "kamikaze_count": 30, "collision_runs": 2, "simulations": 500, "objective": "deviation"}
SIZES |= {"behaviour": "none", "margin_limit": 0}
EPISODES = 30 + 2
BATCH = 20_000  # bytes, with some episodes in them


def test_a_campaign_of_graphs_that_is_killed_goes_on(tmp_path: Path, safe: Path) -> None:
    """It comes to what one in process does that nobody disturbed."""
    (tmp_path / "campaign.yaml").write_text(f"defaults: {json.dumps({**SIZES, 'safe': str(safe), 'graph': True})}\n")
    words = ("campaign", tmp_path / "campaign.yaml", "--out", tmp_path / "out", "-q", "--resume")
    wal = tmp_path / "out" / f"{FILE_NAME}-wal"
    campaign = Skd(*words)
    wait_until(lambda: campaign.has_ended() or (wal.exists() and wal.stat().st_size > BATCH))
    campaign.send_signal(signal.SIGKILL)
    assert campaign.finish().code == -signal.SIGKILL  # which sees that nothing is left
    resumed = skd(*words)
    assert resumed.code == 0, resumed.err
    content = json.loads((tmp_path / "out" / "campaign.json").read_text())
    assert content["episodes_read"] > 0
    assert content["episodes_run"] + content["episodes_read"] == EPISODES
    assert not list((tmp_path / "out").glob(".skd-*"))
    options = [word for key, value in SIZES.items() for word in (f"--{key.replace('_', '-')}", value)]
    whole = tmp_path / "whole"
    assert skd("assess", *options, "--safe", safe, "--workers", 1, "--out", whole).code == 0
    assert_same_results(tmp_path / "out" / "basic-C1", whole)
