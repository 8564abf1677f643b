"""Entry point: parses the command, runs it, and turns errors into one line and an exit code."""

from __future__ import annotations

import argparse
import errno
import gc
import importlib
import io
import os
import sys
from collections.abc import Sequence
from contextlib import ExitStack, redirect_stdout
from pathlib import Path

from skd_sim.errors import UsageError
from skd_sim.inputs.files import one_line

from skd_evaluator.cli.output import EXIT_FAILED, EXIT_INTERRUPTED, EXIT_USAGE, give_up, keep_for_json
from skd_evaluator.cli.parser import make_parser, parse
from skd_evaluator.errors import AssessmentError, OutOfReachError
from skd_evaluator.files import begin_command, what_is_in_place

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
