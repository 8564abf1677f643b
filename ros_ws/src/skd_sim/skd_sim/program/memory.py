"""Memory that the C library keeps for later goes back to the system."""

from __future__ import annotations

import contextlib
import ctypes


def give_back() -> None:
    """Give back what is free in all arenas of the C library (`malloc_trim(3)`); nothing where it is not glibc.

    A graph's threads, Python's and those of its middleware, have arenas of their own, in which what a graph has used is
    kept when it is over; the next one finds some of it, and asks for more.
    """
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
