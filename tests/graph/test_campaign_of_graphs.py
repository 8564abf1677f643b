"""`skd campaign --graphs N` over real graphs: whatever ends it leaves no process, and it goes on where it was."""

from __future__ import annotations

import json
import signal
from pathlib import Path

from common import wait_until
from graph_support import Skd, assert_same_results, skd
from skd_evaluator.assessment.files.episode_store import FILE_NAME

SIZES = {"safe_count": 1, "kamikaze_count": 40, "collision_runs": 4, "simulations": 1500, "objective": "deviation"}
SIZES |= {"behaviour": "none", "margin_limit": 0}
EPISODES = 40 + 4
BATCH = 20_000  # bytes, with some episodes in them


def test_a_campaign_of_graphs_that_is_ended_twice(tmp_path: Path, safe: Path) -> None:
    """It comes to what one in process does that nobody disturbed."""
    (tmp_path / "campaign.yaml").write_text(f"defaults: {json.dumps({**SIZES, 'safe': str(safe), 'graph': True})}\n")
    words = ("campaign", tmp_path / "campaign.yaml", "--graphs", 2, "--out", tmp_path / "out", "-q", "--resume")
    wal = tmp_path / "out" / f"{FILE_NAME}-wal"
    for number, code in ((signal.SIGTERM, 130), (signal.SIGKILL, -signal.SIGKILL)):
        campaign = Skd(*words)
        wait_until(lambda one=campaign: one.has_ended() or (wal.exists() and wal.stat().st_size > BATCH))
        campaign.send_signal(number)
        finished = campaign.finish()  # which sees that nothing is left
        assert finished.code == code, finished.err
        if code > 0:
            assert "interrupted; 0 of 1 cell done, and " in finished.lines[-2]
            assert finished.lines[-1].startswith("skd campaign: go on with: skd campaign ")
            assert finished.lines[-1].endswith(" --resume")
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
