"""`skd completion`: what makes a shell complete commands, options and names."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Final

from skd_sim.errors import UsageError
from skd_sim.options.car_under_test import CONTROLLERS
from skd_sim.options.registry import Registry
from skd_sim.scenario.scenario_file import REGULATORY, SCENARIOS

from skd_evaluator.assessment.options import GENERATED, NO_BEHAVIOUR
from skd_evaluator.cli.parser import commands_of, make_parser
from skd_evaluator.metrics.behaviour import WALKERS

_NAMES: Final[Mapping[str, Callable[[], Iterable[str]]]] = {
    "behaviour": lambda: (WALKERS, NO_BEHAVIOUR),
    "car_model": lambda: (),
    "controller": CONTROLLERS.names,
    "names": SCENARIOS.names,
    "safe": lambda: (*GENERATED, REGULATORY),
    "scenario": SCENARIOS.names,
}
"""Options and arguments that take a name of these, or a file."""


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    try:
        import shtab  # nothing else needs it, and a workspace that colcon has built may do without
    except ModuleNotFoundError as error:
        raise UsageError("skd completion needs shtab, which is not installed: pip install shtab") from error
    parser = make_parser()
    names: dict[str, Callable[[], Iterable[str]]] = {}
    for command in commands_of(parser).values():
        for action in command._actions:
            if action.type is Path:
                action.complete = shtab.FILE  # type: ignore[attr-defined]  # what shtab looks for
            elif hasattr(action, "names") or action.dest in _NAMES:
                names.setdefault(action.dest, getattr(action, "names", None) or _NAMES[action.dest])
                function = _function(action.dest)
                action.complete = {"bash": function, "zsh": function, "tcsh": "f"}  # type: ignore[attr-defined]
            if isinstance(action.choices, Registry):
                action.choices = action.choices.names()
    function_for = {"bash": _for_bash, "zsh": _for_zsh}.get(arguments.shell)
    functions = "" if function_for is None else "".join(function_for(one, names[one]()) for one in names)
    print(shtab.complete(parser, arguments.shell, preamble=functions))
    return 0


def _function(option: str) -> str:
    """Return the name of a shell's function: bash takes what such a one completes for files by `_file` in it."""
    return f"_skd_{option}_or_file"


def _for_bash(option: str, names: Iterable[str]) -> str:
    return f'{_function(option)}() {{\n  compgen -W \'{" ".join(names)}\' -- "$1"\n  compgen -f -- "$1"\n}}\n'


def _for_zsh(option: str, names: Iterable[str]) -> str:
    return f"{_function(option)}() {{\n  _alternative 'names:name:({' '.join(names)})' 'files:file:_files'\n}}\n"
