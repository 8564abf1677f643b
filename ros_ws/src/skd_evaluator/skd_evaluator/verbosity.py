"""How much a command says beside its results: little, as usual, or every step. Light: every command begins with it."""

from __future__ import annotations

import sys


class _Verbosity:
    """What this process says.

    Attributes:
        every_step: whether every step is said.
    """

    every_step = False


def be_verbose(verbose: bool) -> None:
    """Say every step from now on, or no longer."""
    _Verbosity.every_step = verbose


def is_verbose() -> bool:
    """Return whether every step is to be said."""
    return _Verbosity.every_step


def say(line: str) -> None:
    """Say a step on standard error, where every step is to be said."""
    if _Verbosity.every_step:
        print(f"skd: {line}", file=sys.stderr)
