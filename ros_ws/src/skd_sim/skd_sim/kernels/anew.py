"""Whether this process compiles kernels anew, which takes a minute at a first run: whoever waits is to know it."""

from __future__ import annotations

_compiled: list[str] = []


def note(kernel: str) -> None:
    """Take note of a kernel that is compiled, for there is none to load."""
    _compiled.append(kernel)


def any_compiled() -> bool:
    """Return whether one was."""
    return bool(_compiled)
