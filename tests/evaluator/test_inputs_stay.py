"""What a command reads is never what it replaces: `--overwrite` refuses a folder that holds its own input."""

from __future__ import annotations

import argparse
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from cli_support import CONTROLLERS, CROSSING, one_line
from skd_evaluator.cli.arguments import result_folder
from skd_evaluator.cli.commands import commands_of, make_parser
from skd_sim.errors import UsageError

Run = Callable[..., subprocess.CompletedProcess[str]]
SAID = "which this command reads; give another folder"
COMMANDS = {name: one for name, one in commands_of(make_parser()).items() if "--overwrite" in one.format_help()}
SCENARIO = "name: mine\ndescription: mine\nextends: cpna-75\n"
READ = {  # by the name of an option, whatever command has it: the words that have it read something below a folder
    "path": ["{}/file"],
    "paths": ["{}/file"],
    "names": ["{}/mine.yaml"],
    "simulated": ["{}/file", "other"],
    "physical": ["other", "{}/file"],
    "fail_if_worse_than": ["--fail-if-worse-than", "{}"],
    "scenario": ["--scenario", "{}/mine.yaml"],
    "safe": ["--safe", "{}/ways"],
    "car_model": ["--car-model", "{}/file"],
    "behaviour": ["--behaviour", "{}/file"],
    "scenarios": ["--scenarios", "cpna,{}/mine.yaml"],
    "message_folder": ["--message-folder", "{}/messages"],
    "controller": ["--controller", "cars_in_it:Fine"],
}


def texts_of(parser: argparse.ArgumentParser) -> set[str]:
    """Return the options that take a text or a path, by name."""
    kinds = (None, str, Path)
    takes = (one for one in parser._actions if one.nargs != 0 and one.type in kinds and one.choices is None)
    return {one.dest for one in takes if one.dest != "help"}


@pytest.mark.parametrize("command", sorted(set(COMMANDS) - {"campaign", "report"}))
def test_every_input_of_every_command_is_kept(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Straight into the folder, through a link, and by a way round; `campaign` and `report` follow below."""
    (tmp_path / "base").mkdir()
    for name in ("assessment.json", "file"):
        (tmp_path / "base" / name).write_text("{}")
    (tmp_path / "base" / "mine.yaml").write_text(SCENARIO)
    (tmp_path / "base" / "cars_in_it.py").write_text(CONTROLLERS)
    (tmp_path / "link").symlink_to("base")
    (tmp_path / "base" / "outward").symlink_to(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path / "base"))
    needed = {"scenarios": ["check"], "export": ["--format", "csv"]}.get(command, [])
    positional = [one.dest for one in COMMANDS[command]._actions if not one.option_strings and one.choices is None]
    tried = 0
    for name in texts_of(COMMANDS[command]) & set(READ):
        for folder, out in (("base", "base"), ("link", "base"), ("base", "link"), ("other/../base", "base")):
            filled = [] if name in positional else ["other"] * (2 if command == "fuse" else len(positional))
            if command == "fuse" and name == "reference":
                continue  # a number
            words = [*needed, *filled, *(word.format(folder) for word in READ[name])]
            found = make_parser().parse_args([command, *words, "--out", out, "--overwrite"])
            with pytest.raises(UsageError, match=SAID):
                result_folder(found)
            tried += 1
    assert tried >= 4
    # What is beside it is not.
    words = [*needed, *["other"] * (2 if command == "fuse" else len(positional))]
    beside = make_parser().parse_args([command, *words, "--out", "base", "--overwrite"])
    assert result_folder(beside).path == Path("base")


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
