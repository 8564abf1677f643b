"""A campaign whose processes are killed comes to the same as one that nobody disturbed, and runs nothing twice."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from campaign_kills import Processes, differences, disturbed
from common import run_skd
from skd_evaluator.campaigns.store import FILE_NAME

CAMPAIGN = """
defaults: {safe: walk.csv, safe_count: 1, kamikaze_count: 40, collision_runs: 40, simulations: 300, objective: paper}
sweep: {seed: [0, 1]}
"""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("campaign")
    (folder / "walk.csv").write_text("t,x,y\n0,-3,0\n2,3,0\n")
    (folder / "campaign.yaml").write_text(CAMPAIGN)
    assert run_skd("campaign", folder / "campaign.yaml", "--out", folder / "whole", "--workers", "1", "-q") == 0
    return folder / "whole"


def after_bytes(out: Path, count: int) -> Callable[[float], bool]:
    """Once so much has been written of episodes."""
    wal = out / f"{FILE_NAME}-wal"
    return lambda _seconds: wal.exists() and wal.stat().st_size > count


@pytest.mark.parametrize(("what", "moments"), [("parent", [20_000, 150_000]), ("worker", [20_000])])
def test_a_killed_campaign_is_as_one_that_was_not(whole, tmp_path, what, moments):
    out = tmp_path / "out"
    killed = disturbed(
        whole.parent / "campaign.yaml",
        out,
        whole,
        what,
        Processes(2),
        [after_bytes(out, count) for count in moments],
        random.Random(0),
    )
    assert killed is not None
    assert killed.differences == ()
    assert killed.resumed == (what == "parent")


def test_a_difference_is_one(whole, tmp_path):
    assert differences(whole, whole) == []
    shutil.copytree(whole, tmp_path / "other")
    assert differences(tmp_path / "other", whole) == []
    content = bytearray((tmp_path / "other" / "basic-C1_seed=0" / "episodes.npz").read_bytes())
    content[-1] ^= 1
    (tmp_path / "other" / "basic-C1_seed=0" / "episodes.npz").write_bytes(content)
    assert differences(tmp_path / "other", whole) == ["basic-C1_seed=0/episodes.npz"]
