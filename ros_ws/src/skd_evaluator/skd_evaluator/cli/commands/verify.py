"""`skd verify`: whether results are unchanged, and whether their figures follow from their episodes."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from skd_sim.inputs.files import one_line
from skd_sim.options.registry import Registry

from skd_evaluator.cli.arguments import Parser
from skd_evaluator.cli.output import print_json

if TYPE_CHECKING:
    from skd_evaluator.assessment.files.verification import Verified

_SHOWN = 20
_CHECKS = Registry("check of results", "skd.checks", {})
"""Functions of extensions that are given what is found in a folder and return it with what they find."""


def add(parser: Parser) -> None:
    """Check that results are unchanged and follow from their episodes.

    Compare the files of a result with their checksums, compute every figure anew from the episodes, and check that each
    episode can have happened. The exit code is 1 if something does not agree.
    """
    parser.set_defaults(group="compare and gate")
    parser.add_paths("DIR", "folder of an assessment, a sweep or a campaign, or a folder of such")
    parser.add_flag("--json", "print JSON, which names every figure, instead of lines")


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    from skd_evaluator.assessment.files.verification import folders_below, verify

    found = []
    for folder in dict.fromkeys(folder for path in arguments.paths for folder in folders_below(path)):
        one = verify(folder)
        for name in _CHECKS.registered():
            one = _CHECKS.find(name)(one)
        found.append(one)
    fine = all(one.fine for one in found)
    if arguments.json:
        print_json({"fine": fine, "results": [one.as_dict() for one in found]})
    else:
        for line in (line for one in found for line in _lines(one)):
            print(one_line(line))
    return 0 if fine else 1


def _lines(one: Verified) -> list[str]:
    lines = [f"{one.folder}: {'fine' if one.fine else 'NOT FINE'}"]
    lines += _some([f"  {name}: {what}" for name, what in (one.files or {}).items()])
    lines += [f"  {len(one.agree)} figures recomputed, all as stored"] if one.agree else []
    lines += _some([f"  contradicted: {line}" for line in one.contradict])
    lines += _some([f"  wrong: {line}" for line in one.problems])
    lines += [f"  {len(one.unknown)} further keys cannot be recomputed; --json names them"] if one.unknown else []
    return [*lines, *(f"  {line}" for line in one.remarks)]


def _some(lines: list[str]) -> list[str]:
    rest = len(lines) - _SHOWN
    return [*lines[:_SHOWN], f"  … and {rest} more"] if rest > 0 else lines
