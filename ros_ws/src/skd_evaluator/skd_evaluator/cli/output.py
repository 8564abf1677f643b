"""What a command prints: a result or with --json only JSON on standard output, all else on standard error."""

from __future__ import annotations

import argparse
import io
import os
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import IO, Any

from skd_sim.inputs.files import one_line

EXIT_FAILED, EXIT_USAGE, EXIT_INTERRUPTED = 1, 2, 130


class _Standard:
    """The program's standard output, where only JSON may go to it.

    Attributes:
        output: that output; None where anything may go to it.
    """

    output: IO[str] | None = None


def keep_for_json() -> None:
    """Keep standard output for `print_json`, for good: what anything else prints from now on goes to standard error.

    Descriptor 1 itself is led there, so that it holds for code in C and in processes that are started or forked; and to
    the end, for C writes what it has kept when the process ends.
    """
    behind = sys.stdout
    if behind is not sys.__stdout__ or not isinstance(behind, io.TextIOWrapper) or behind.fileno() != 1:
        return  # it leads elsewhere already, as in tests
    behind.flush()
    _Standard.output = os.fdopen(os.dup(1), "w", encoding=behind.encoding, errors="replace")
    os.dup2(2, 1)


def print_json(content: Mapping[str, Any]) -> None:
    """Print JSON to standard output."""
    import json  # only now: every command begins with this module

    print(json.dumps(content, indent=2, ensure_ascii=False), file=_Standard.output)
    if _Standard.output is not None:
        _Standard.output.flush()


def say(command: str, *lines: str) -> None:
    """Print lines that are no result on standard error, each with the name of its command."""
    for line in lines:
        print(f"skd {command}: {one_line(line)}", file=sys.stderr, flush=True)


def warn(command: str, lines: Iterable[str]) -> None:
    """Print warnings on standard error, each of them once."""
    say(command, *(f"warning: {line}" for line in dict.fromkeys(lines)))


def finish(
    arguments: argparse.Namespace,
    content: Mapping[str, Any],
    show: Callable[[], None],
    warnings: Iterable[str] = (),
    failures: Sequence[str | None] = (),
    *,
    saved: tuple[str | None, str] = (None, ""),
    since: float | None = None,
) -> int:
    """Print a result, where it is, what is to be known of it, and why it failed; return the exit code.

    Args:
        arguments: arguments of the command.
        content: the result as JSON has it.
        show: prints it for people.
        warnings: what to know of it, a line each.
        failures: why the command failed, a line each; None is no failure.
        saved: why the result could not be written, and where it is if it was.
        since: when the command began, by `time.perf_counter`; None: how long it took is not said.
    """
    problem, where = saved
    if arguments.json:
        print_json(content)
    else:
        show()
        took = "" if since is None else f"{time.perf_counter() - since:.1f} s"
        if line := "; ".join(filter(None, (took, "" if problem else where))):
            print(line)
    warn(arguments.command, warnings)
    failed = [why for why in (*failures, problem) if why]
    say(arguments.command, *failed)
    return 1 if failed else 0


def is_read(printing: Callable[[], None]) -> bool:
    """Print before something is written; return False where the reader has gone away, and drop all further output."""
    try:
        printing()
        sys.stdout.flush()
    except BrokenPipeError:
        give_up()
        return False
    return True


def give_up() -> None:
    """Drop output whose reader has gone away: Python would complain when it flushes at the end."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    if _Standard.output is not None:
        os.dup2(nowhere, _Standard.output.fileno())
