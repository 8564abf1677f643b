"""How much a command says beside its results: little, as usual, or every step. Light: every command begins with it."""

from __future__ import annotations

import sys

_verbose = False


def be_verbose(verbose: bool) -> None:
    """Say every step from now on, or no longer."""
    global _verbose
    _verbose = verbose


def is_verbose() -> bool:
    """Return whether every step is to be said."""
    return _verbose


def say(line: str) -> None:
    """Say a step on standard error, where every step is to be said."""
    if _verbose:
        print(f"skd: {line}", file=sys.stderr)
