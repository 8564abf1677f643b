"""`skd completion`: what makes a shell complete commands, options and names."""

from __future__ import annotations

import argparse
from pathlib import Path

from skd_sim.choices.registry import Registry
from skd_sim.errors import UsageError

from skd_evaluator.cli.parser import commands_of, make_parser


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    try:
        import shtab  # nothing else needs it, and a workspace that colcon has built may do without
    except ModuleNotFoundError as error:
        raise UsageError("skd completion needs shtab, which is not installed: pip install shtab") from error
    parser = make_parser()
    for command in commands_of(parser).values():
        for action in command._actions:
            if action.type is Path or action.dest in ("safe", "car_model", "scenario"):
                action.complete = shtab.FILE  # type: ignore[attr-defined]  # what shtab looks for
            if isinstance(action.choices, Registry):
                action.choices = action.choices.names()
    print(shtab.complete(parser, arguments.shell))
    return 0
