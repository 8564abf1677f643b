"""The files for continuous integration are YAML, and every command of ours in them exists."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from typing import Any

import pytest
import yaml
from packaging_support import ROOT
from skd_evaluator.assessment.files.assessment_json import check_figure
from skd_evaluator.cli.commands import make_parser

FOLDER = ROOT / "examples" / "ci"


def commands(content: Any) -> Iterator[str]:
    """Every line of a `run` or a `script`."""
    if isinstance(content, dict):
        for key, value in content.items():
            if key == "run":
                yield from value.splitlines()
            elif key == "script":
                yield from (line for entry in value for line in entry.splitlines())
            else:
                yield from commands(value)
    elif isinstance(content, list):
        for value in content:
            yield from commands(value)


def ours(name: str) -> list[list[str]]:
    content = yaml.safe_load((FOLDER / name).read_text(encoding="utf-8"))
    return [words for line in commands(content) if (words := shlex.split(line)) and words[0] == "skd"]


@pytest.mark.parametrize("name", ["github-actions.yml", "gitlab-ci.yml"])
def test_commands_are_ones_that_there_are(name):
    (words,) = ours(name)
    asked = make_parser().parse_args(words[1:])
    assert asked.command == "assess"
    for figure, _ in (*asked.fail_below, *asked.fail_above):
        check_figure(figure)
    assert (str(asked.junit), str(asked.markdown)) == ("skd.xml", "skd.md")
    assert asked.fail_if_worse_than is not None


def test_what_is_made_is_kept():
    github = yaml.safe_load((FOLDER / "github-actions.yml").read_text(encoding="utf-8"))
    steps = github["jobs"]["rating"]["steps"]
    (upload,) = [step for step in steps if "upload-artifact" in step.get("uses", "")]
    made = {"skd-result", "skd.xml", "skd.md"}
    assert set(upload["with"]["path"].split()) == made
    assert upload["if"] == "always()"  # most of all when the gate has failed
    gitlab = yaml.safe_load((FOLDER / "gitlab-ci.yml").read_text(encoding="utf-8"))["skd"]["artifacts"]
    assert (set(gitlab["paths"]), gitlab["when"], gitlab["reports"]["junit"]) == (made, "always", "skd.xml")
