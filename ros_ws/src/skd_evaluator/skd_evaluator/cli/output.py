"""What goes to standard output: with --json only JSON, whatever else is printed meanwhile."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable, Iterable, Mapping
from typing import IO, Any


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
        return  # somebody has led it elsewhere already, as tests do
    behind.flush()
    _Standard.output = os.fdopen(os.dup(1), "w", encoding=behind.encoding, errors="replace")
    os.dup2(2, 1)


def print_json(content: Mapping[str, Any]) -> None:
    """Print JSON to standard output."""
    import json  # only now: every command begins with this module

    text = json.dumps(content, indent=2, ensure_ascii=False)
    print(text, file=_Standard.output)
    if _Standard.output is not None:
        _Standard.output.flush()


def closing(command: str, warnings: Iterable[str], problem: str | None = None) -> int:
    """Print warnings, and why a result was not written, to standard error; return the exit code of a command."""
    for line in dict.fromkeys(warnings):
        print(f"skd {command}: warning: {line}", file=sys.stderr)
    if problem:
        print(f"skd {command}: {problem}", file=sys.stderr)
    return 1 if problem else 0


def is_read(printing: Callable[[], None]) -> bool:
    """Print before something is written, which is to be written whether anybody reads what is printed or not.

    Returns:
        Whether somebody did; where nobody does, further output is dropped.
    """
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
