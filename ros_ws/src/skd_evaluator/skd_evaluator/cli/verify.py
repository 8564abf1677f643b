"""`skd verify`: whether results are unchanged, and whether their figures follow from their episodes."""

from __future__ import annotations

import argparse
from pathlib import Path

from skd_sim.inputs.files import one_line
from skd_sim.options.registry import Registry

from skd_evaluator.assessment.files.verification import Verified, folders_below, verify
from skd_evaluator.cli.output import print_json
from skd_evaluator.report.terminal import counted

_SHOWN = 20
_CHECKS = Registry("check of results", "skd.checks", {})
"""Functions of extensions that are given what is found in a folder and return it with what they find."""


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    folders = [folder for path in arguments.paths for folder in folders_below(path)]
    found = [_verified(folder) for folder in dict.fromkeys(folders)]
    fine = all(one.fine for one in found)
    if arguments.json:
        print_json({"fine": fine, "results": [one.as_dict() for one in found]})
        return 0 if fine else 1
    for one in found:
        for line in _lines(one):
            print(one_line(line))
    return 0 if fine else 1


def _verified(folder: Path) -> Verified:
    """Return what is found in a folder, by the checks of extensions, too."""
    found = verify(folder)
    for name in _CHECKS.registered():
        found = _CHECKS.find(name)(found)
    return found


def _lines(one: Verified) -> list[str]:
    lines = [f"{one.folder}: {'fine' if one.fine else 'NOT FINE'}"]
    lines += _some([f"  {name}: {what}" for name, what in (one.files or {}).items()])
    lines.append(f"  {counted(len(one.agree), 'figure')} recomputed, and as said")
    lines += _some([f"  contradicted: {line}" for line in one.contradict])
    lines += _some([f"  wrong: {line}" for line in one.problems])
    lines += [f"  not recomputed: {', '.join(one.unknown)}"] if one.unknown else []
    return [*lines, *(f"  {line}" for line in one.remarks)]


def _some(lines: list[str]) -> list[str]:
    rest = len(lines) - _SHOWN
    return [*lines[:_SHOWN], f"  … and {rest} more"] if rest > 0 else lines
