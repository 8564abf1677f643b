"""Every command that offers `--sign` signs: what is no key is refused, before there is anything to sign."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from cli_support import one_line
from skd_evaluator.cli.commands import episode
from skd_evaluator.cli.parser import commands_of, make_parser
from test_signatures import SIGNATURE, write_key

Run = Callable[..., subprocess.CompletedProcess[str]]
RESULT, OTHER = "<a result>", "<another>"
WORDS: dict[str, list[list[str]]] = {
    "assess": [[]],
    "sweep": [[]],
    "campaign": [["campaign.yaml"]],
    "episode": [[]],
    "replay": [["recorded"]],
    "compare": [[RESULT, OTHER]],
    "show": [[RESULT]],
    "encounters": [["show", "cpna"], ["check", "mine.yaml"], ["reference", "cpna"]],
    "ncap": [[]],
    "probe": [[]],
    "fit": [["recorded"], [RESULT, "trials.csv", "--simulator"]],
    "fuse": [[RESULT, "trials.csv"]],
    "behaviour": [["fit", "tracks"]],
    "export": [[RESULT, "--format", "csv"]],
    "import": [["recorded"]],
    "trend": [[RESULT, OTHER]],
}
"""What each of them needs beside its key, as far as anything is looked at before the key is."""
SIGNING = sorted(name for name, one in commands_of(make_parser()).items() if "--sign" in one.format_help())


def test_those_that_are_tried_are_all_that_sign() -> None:
    assert sorted(WORDS) == SIGNING


@pytest.mark.parametrize("command", SIGNING)
def test_a_key_that_is_not_there_is_refused_by_whoever_offers_to_sign(
    command: str, skd_here: Run, here: Path, sweep: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three commands took any word for a key, signed nothing, and ended with exit code 0."""
    monkeypatch.setattr(episode, "prepare_ros", lambda _options: None)
    (here / "campaign.yaml").write_text("cars: [{controller: basic}]\n")
    (here / "mine.yaml").write_text("name: mine\ndescription: mine\nextends: cpna-75\n")
    places = {RESULT: str(sweep / "synthetic" / "C_0.5"), OTHER: str(sweep / "synthetic" / "C_1")}
    for words in WORDS[command]:
        done = skd_here(command, *(places.get(word, word) for word in words), "--out", "out", "--sign", "gone")
        one_line(done, 2, "--sign gone: cannot be read (No such file or directory)")
        assert not (here / "out").exists()


def test_encounters_are_signed_where_they_are_a_folder(skd_here: Run, here: Path) -> None:
    key = write_key(here / "key")
    for words in (["show", "cpna"], ["reference", "crossing", "--multipliers", "1", "--attempts", "1"]):
        done = skd_here("encounters", *words, "--out", words[0], "--sign", "key")
        assert done.returncode == 0, done.stderr
        assert (here / words[0] / SIGNATURE).is_file()
        verified = skd_here("verify", words[0], "--key", str(key.with_suffix(".pub")))
        assert (verified.returncode, "signed by the key" in verified.stdout) == (0, True)
    for words in (["campaign", "cpna", "--speeds", "10:20:10"], ["list"]):
        one_line(skd_here("encounters", *words, "--sign", "key"), 2, "--sign is for a folder of results")
