"""Entry point: parses the command, runs it, and turns errors into one line and an exit code."""

from __future__ import annotations

import argparse
import importlib
import io
import os
import sys
from collections.abc import Sequence
from typing import NoReturn

from skd_sim.errors import UsageError

from skd_evaluator.cli import options
from skd_evaluator.errors import AssessmentError

EXIT_FINE, EXIT_FAILED, EXIT_USAGE, EXIT_INTERRUPTED = 0, 1, 2, 130


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(EXIT_USAGE, f"{self.prog}: error: {message} (see {self.prog} --help)\n")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code: 0 fine, 1 the assessment failed, 2 wrong usage."""
    parser = _Parser(prog="skd", description="Safe-Kamikaze Distance: how safe is a self-driving car's software?")
    options.add_commands(parser, _Parser)
    words = sys.argv[1:] if argv is None else list(argv)
    arguments, unknown = parser.parse_known_args(words)
    arguments.command_line = ["skd", *words]
    if unknown:
        _Parser(prog=f"skd {arguments.command}").error(f"unrecognized arguments: {' '.join(unknown)}")
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # φ on a terminal that knows no Greek
    try:
        if getattr(arguments, "graph", arguments.command == "episode"):
            from skd_sim import ros_environment

            if ros_environment.is_ready():
                ros_environment.enter_ros()  # before anything slow is imported, for it begins this process anew
        # Imported only now: `skd --help` must not wait for numba and matplotlib.
        command = importlib.import_module(f"skd_evaluator.cli.{arguments.command}")
        code = int(command.run(arguments))
        sys.stdout.flush()
        return code
    except UsageError as error:
        print(f"skd {arguments.command}: error: {error}", file=sys.stderr)
        return EXIT_USAGE
    except AssessmentError as error:
        print(f"skd {arguments.command}: error: {error}", file=sys.stderr)
        return EXIT_FAILED
    except KeyboardInterrupt:
        print(f"skd {arguments.command}: interrupted; nothing was written", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # The reader of a pipe went away, as `head` does; Python would complain when it flushes at the end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_FAILED
    except OSError as error:
        print(f"skd {arguments.command}: error: {error}", file=sys.stderr)
        return EXIT_FAILED
