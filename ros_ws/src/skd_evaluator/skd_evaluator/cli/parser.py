"""The parser of the command line: errors are one line, and say what may have been meant."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterable, Sequence
from typing import Any, NoReturn

from skd_sim.errors import UsageError
from skd_sim.inputs.files import did_you_mean
from skd_sim.options.registry import Registry

from skd_evaluator.cli import options

EXIT_USAGE = 2
COMMANDS = "skd.commands"
"""Group of entry points: functions that add a command's parser to what `ArgumentParser.add_subparsers` returns. The
parser's default `module` names the module whose `run` is given the arguments and returns the exit code."""


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        """Leave with the message."""
        self.exit(EXIT_USAGE, f"{self.prog}: error: {message} (see {self.prog} --help)\n")

    def _print_message(self, message: str, file: Any = None) -> None:
        if message and file is not None and file is sys.stdout:
            file.write(message)  # Python's own drops without a word what the disk does not take
        else:
            super()._print_message(message, file)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        try:
            super()._check_value(action, value)
        except argparse.ArgumentError as error:
            error.message += did_you_mean(str(value), map(str, action.choices or ()))
            raise


def make_parser(words: Sequence[str] = ()) -> Parser:
    """Return the parser of all commands; of SKD's own alone if the first word is one of these, which is quicker."""
    parser = Parser(
        prog="skd",
        description="How safe is a self-driving car's software? SKD bends safe "
        "crossings until the car hits somebody, and measures how far they had to be bent.",
    )
    commands = options.add_commands(parser, Parser)
    if not words or words[0] not in commands.choices:
        _add_registered(commands)
    return parser


def _add_registered(commands: Any) -> None:
    """Add the commands of extensions and of installed packages; one that cannot be loaded says so."""
    registry = Registry("command", COMMANDS, dict.fromkeys(commands.choices, ""))
    for name in registry.registered():
        try:
            registry.find(name)(commands)
        except UsageError as error:
            commands.add_parser(name, help=str(error)).set_defaults(problem=str(error))


def parse(parser: Parser, words: Sequence[str]) -> argparse.Namespace:
    """Return what a command line asks for; wrong usage ends the program."""
    arguments, unknown = parser.parse_known_args(words)
    chosen = commands_of(parser)[arguments.command]
    if problem := getattr(arguments, "problem", ""):
        parser.exit(EXIT_USAGE, f"{parser.prog}: error: {problem}\n")
    if strange := next((word for word in words if not _can_be_written(word)), ""):
        chosen.error(f"{strange!r} has bytes that are no text in UTF-8, and no result can name it; give another name")
    if unknown:
        flags = [flag for action in chosen._actions for flag in action.option_strings]
        near = next(filter(None, (did_you_mean(flag, flags) for flag in _flags(unknown))), "")
        chosen.error(f"unrecognized arguments: {' '.join(unknown)}{near}")
    return arguments


def commands_of(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """Return the parser of each command."""
    (found,) = (action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    return dict(found.choices)


def _can_be_written(word: str) -> bool:
    return not any("\ud800" <= one <= "\udfff" for one in word)


def _flags(words: Iterable[str]) -> list[str]:
    return [word.partition("=")[0] for word in words if re.match(r"--\w", word)]
