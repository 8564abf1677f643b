"""What a command reads is never what it replaces: `--overwrite` refuses a folder that holds its own input."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from cli_support import CONTROLLERS, CROSSING, one_line
from skd_evaluator.cli.arguments import result_folder
from skd_evaluator.cli.parser import make_parser
from skd_sim.errors import UsageError

Run = Callable[..., subprocess.CompletedProcess[str]]
SCENARIO = "name: mine\ndescription: mine\nextends: cpna-75\n"
READ = [
    ["replay", "{}/file"],
    ["compare", "other", "{}/file"],
    ["scenarios", "check", "{}/mine.yaml"],
    ["fuse", "other", "{}/file"],
    ["assess", "--fail-if-worse-than", "{}"],
    ["assess", "--scenario", "{}/mine.yaml"],
    ["assess", "--safe", "{}/ways"],
    ["assess", "--car-model", "{}/file"],
    ["assess", "--behaviour", "{}/file"],
    ["assess", "--message-folder", "{}/messages"],
    ["assess", "--controller", "cars_in_it:Fine"],
    ["ncap", "--scenarios", "cpna,{}/mine.yaml"],
]


@pytest.mark.parametrize("words", READ, ids=" ".join)
def test_every_input_is_kept(words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Straight into the folder, through a link, and by a way round."""
    (tmp_path / "base").mkdir()
    for name, text in (("assessment.json", "{}"), ("mine.yaml", SCENARIO), ("cars_in_it.py", CONTROLLERS)):
        (tmp_path / "base" / name).write_text(text)
    (tmp_path / "link").symlink_to("base")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path / "base"))
    for folder, out in (("base", "base"), ("link", "base"), ("base", "link"), ("other/../base", "base")):
        filled = [word.format(folder) for word in words]
        found = make_parser().parse_args([*filled, "--out", out, "--overwrite"])
        with pytest.raises(UsageError, match="which this command reads; give another folder"):
            result_folder(found)


def test_a_campaign_keeps_what_it_reads_and_can_be_resumed(skd_here: Run, here: Path) -> None:
    """Its own file may lie in its folder, which stays; what its cells read may not."""
    counts = "safe_count: 1, kamikaze_count: 1, collision_runs: 1, simulations: 10, margin_limit: 0, behaviour: none"
    text = f"defaults: {{{counts}}}\ncars: [{{controller: basic, name: mine}}]\n"
    (here / "campaign.yaml").write_text(text)
    words = ("campaign", "campaign.yaml", "--out", "out", "--workers", "1")
    assert skd_here(*words).returncode == 0
    (here / "out" / "mine" / "own.csv").write_text(CROSSING)
    (here / "campaign.yaml").write_text(f"{text}scenarios: [{{safe: out/mine/own.csv, name: there}}]\n")
    one_line(skd_here(*words, "--overwrite"), 2, "holds out/mine/own.csv, which this command reads")
    (here / "campaign.yaml").write_text(text)
    (here / "campaign.yaml").rename(here / "out" / "campaign.yaml")
    words = ("campaign", "out/campaign.yaml", "--out", "out", "--workers", "1")
    for how in ("--resume", "--overwrite"):
        done = skd_here(*words, how)
        assert done.returncode == 0, done.stderr
        assert (here / "out" / "campaign.yaml").read_text() == text
