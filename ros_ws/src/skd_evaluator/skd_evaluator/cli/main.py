"""Entry point: finds the commands, parses one, runs it, and turns errors into one line and an exit code.

Light: every start has it.
"""

from __future__ import annotations

import argparse
import errno
import gc
import importlib
import inspect
import io
import os
import pkgutil
import re
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack, redirect_stdout
from pathlib import Path
from typing import Any

from skd_sim.errors import AssessmentError, OutOfReachError, UsageError
from skd_sim.inputs.files import did_you_mean, one_line
from skd_sim.options.registry import Registry

from skd_evaluator.cli import commands as own
from skd_evaluator.cli.arguments import Parser, rare
from skd_evaluator.cli.output import EXIT_FAILED, EXIT_INTERRUPTED, EXIT_USAGE, give_up, keep_for_json
from skd_evaluator.files import begin_command, what_is_in_place

COMMANDS = "skd.commands"
"""Group of entry points of further commands: functions as `add` in `cli/commands`, each in a module with a `run`."""
GROUPS = ("rate", "look", "compare and gate", "exchange", "research", "of installed packages")
"""Headings of the help, in order; a command that names none of its own stands under the last."""


def _add(commands: Any, name: str, add: Callable[[Parser], None]) -> None:
    """Add a command: its help is the docstring of the function that adds its options, whose module has its `run`."""
    first, _, rest = (inspect.getdoc(add) or "").partition("\n")
    text = " ".join(rest.split()) or first
    said = (first[:1].lower() + first[1:]).removesuffix(".")
    found: Parser = commands.add_parser(name, help=said.replace("%", "%%"), description=text)
    found.set_defaults(module=add.__module__, command=name)
    add(found)


class _Skd(Parser):
    """The parser of all commands, whose help has them in groups; those with `rare=True` only with --help-all."""

    def format_help(self) -> str:
        """Return the help."""
        (commands,) = (one for one in self._actions if isinstance(one, argparse._SubParsersAction))
        rows: dict[str, list[str]] = {group: [] for group in GROUPS}
        hidden = 0
        for one in sorted(commands._choices_actions, key=lambda one: one.dest):
            found = commands.choices[one.dest]
            if found.get_default("rare") and not self.everything:
                hidden += 1
            else:
                rows[found.get_default("group") or GROUPS[-1]].append(f"  {one.dest:<10}{one.help}")
        lines = [f"usage: skd COMMAND [options]\n\n{self.description}"]
        lines += ["\n".join(["", group, *texts]) for group, texts in rows.items() if texts]
        more = f"skd --help-all lists {hidden} more commands. " if hidden else ""
        return "\n".join([*lines, "", f"{more}skd COMMAND --help explains one, skd --version names the version.", ""])


def make_parser(words: Sequence[str] = ()) -> Parser:
    """Return the parser of all commands; of the first word alone if that is one of SKD's own, which is quicker."""
    Parser.everything = "--help-all" in words
    parser = _Skd(
        prog="skd",
        description="Measure how far a pedestrian may deviate from a safe crossing before a self-driving car collides.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version and exit")
    parser.add_argument("--help-all", action="help")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=Parser)
    names = [one.name for one in pkgutil.iter_modules(own.__path__)]
    for name in words[:1] if words and words[0] in names else names:
        _add(commands, name, importlib.import_module(f"{own.__name__}.{name}").add)
    if not words or words[0] not in names:
        registry = Registry("command", COMMANDS, dict.fromkeys(names, ""))
        for name in registry.registered():
            try:
                _add(commands, name, registry.find(name))
            except UsageError as error:  # it cannot be loaded
                commands.add_parser(name, help=str(error)).set_defaults(problem=str(error))
    for one in commands.choices.values():
        one.add_argument("--help-all", action="help", help=rare("show all options, rare ones too, and exit"))
        if not Parser.everything:
            one._actions[0].help = argparse.SUPPRESS  # -h, which was just given
    return parser


def parse(parser: Parser, words: Sequence[str]) -> argparse.Namespace:
    """Return what a command line requests, with the parameters that it names; wrong usage ends the program.

    Raises:
        UsageError: a parameter is wrong.
    """
    if not words:
        words = ["--help"]
    rest: list[str] | None = None
    if "--" in words and (first := commands_of(parser).get(words[0])) and first.get_default("words") is not None:
        words, rest = words[: words.index("--")], list(words[words.index("--") + 1 :])
    arguments, unknown = parser.parse_known_args(words)
    if rest is not None:  # the words of another command
        arguments.words = rest
    chosen = commands_of(parser)[arguments.command]
    if problem := getattr(arguments, "problem", ""):
        parser.exit(EXIT_USAGE, f"{parser.prog}: error: {problem}\n")
    if strange := next((word for word in words if re.search("[\ud800-\udfff]", word)), ""):
        chosen.error(f"{strange!r} has bytes that are no text in UTF-8; give another name")
    if unknown:
        flags = [flag for action in chosen._actions for flag in action.option_strings]
        given = [word.partition("=")[0] for word in unknown if re.match(r"--\w", word)]
        near = next(filter(None, (did_you_mean(flag, flags) for flag in given)), "")
        chosen.error(f"unrecognized arguments: {' '.join(unknown)}{near}")
    read = getattr(arguments, "read_parameters", None)  # of a command that takes -p and --params-file
    if read is not None and (found := read(arguments)):
        chosen.set_defaults(**found)
        arguments = parser.parse_args(words)
    return arguments


def commands_of(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """Return the parser of each command."""
    (found,) = (action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    return dict(found.choices)


class _Version(argparse.Action):
    """Prints the version; the lookup is made only when it is requested."""

    def __call__(self, parser: argparse.ArgumentParser, *_ignored: object) -> None:
        from skd_evaluator.version import version

        print(f"skd {version()}")
        parser.exit()


_OF_NAMES = (errno.ENAMETOOLONG, errno.ELOOP)
"""Errors of names that were given, and not of the machine."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code: 0 fine, 1 the assessment failed, 2 wrong usage."""
    words = sys.argv[1:] if argv is None else list(argv)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # φ on a terminal that knows no Greek
    name, verbose = " ".join(["skd", *(word for word in words[:1] if word[:1] != "-")]), False
    try:
        arguments = _parsed(words)
        arguments.command_line = ["skd", *words]
        begin_command()
        verbose = getattr(arguments, "verbose", False)
        if getattr(arguments, "graph", arguments.command == "episode"):
            from skd_sim.ros_environment.installation import enter_ros, is_ready

            if is_ready():
                enter_ros()  # before anything slow is imported, for it begins this process anew
        as_json = getattr(arguments, "json", False)
        if as_json:
            keep_for_json()
        gc.set_threshold(50_000)  # or a sixth of the time in which a command imports goes to looking for garbage
        command = importlib.import_module(arguments.module)
        with ExitStack() as stack:
            if getattr(arguments, "quiet", False) and not as_json:
                stack.enter_context(redirect_stdout(stack.enter_context(open(os.devnull, "w"))))  # noqa: PTH123
            code = int(command.run(arguments))
        sys.stdout.flush()
        return code
    except (UsageError, AssessmentError, OutOfReachError) as error:
        if verbose:
            import traceback  # only now: every command begins with this module

            traceback.print_exc()
        print(f"{name}: error: {one_line(str(error))}", file=sys.stderr)
        return EXIT_USAGE if isinstance(error, UsageError) else EXIT_FAILED
    except KeyboardInterrupt:
        print(f"{name}: interrupted; {one_line(what_is_in_place())}", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        give_up()
        return EXIT_FAILED
    except OSError as error:
        if error.errno in _OF_NAMES:
            why = f"{str(error.filename)[:60]}: no file can have that name ({error.strerror})"
            print(f"{name}: error: {one_line(why)}", file=sys.stderr)
            return EXIT_USAGE
        if error.errno == errno.ENOSPC and error.filename is None:
            give_up()  # it may be the output itself
        why = str(error) if _is_somewhere() else "the current folder was removed; go to one that is there"
        print(f"{name}: error: {one_line(why)}", file=sys.stderr)
        return EXIT_FAILED
    except MemoryError:
        print(f"{name}: error: out of memory (limit: ulimit -v)", file=sys.stderr)
        return EXIT_FAILED


def _parsed(words: list[str]) -> argparse.Namespace:
    """Return what is asked for; --help and --version end the program when they are written, as wrong usage does."""
    try:
        return parse(make_parser(words), words)
    except SystemExit:
        sys.stdout.flush()
        raise


def _is_somewhere() -> bool:
    """Return whether the current folder is there; without it nothing that is relative to it can be found."""
    try:
        return bool(Path.cwd())
    except FileNotFoundError:
        return False
