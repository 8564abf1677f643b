"""`skd completion`: what makes a shell complete commands, options and names."""

from __future__ import annotations

import argparse
from pathlib import Path

import shtab
from skd_sim.registry import Registry

from skd_evaluator.cli.parser import commands_of, make_parser


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    parser = make_parser()
    for command in commands_of(parser).values():
        for action in command._actions:
            if action.type is Path or action.dest in ("safe", "car_model", "scenario"):
                action.complete = shtab.FILE  # type: ignore[attr-defined]  # what shtab looks for
            if isinstance(action.choices, Registry):
                action.choices = action.choices.names()
    print(shtab.complete(parser, arguments.shell))
    return 0
