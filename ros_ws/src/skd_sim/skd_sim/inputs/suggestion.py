"""What somebody may have meant by an unknown name."""

from __future__ import annotations

from collections.abc import Iterable


def nearest(name: str, known: Iterable[str]) -> str | None:
    """Return the known name that is nearest; none where none is near."""
    from difflib import get_close_matches  # only where something is wrong

    by_case = {one.lower(): one for one in known}
    near = get_close_matches(name.lower(), by_case, n=1, cutoff=0.6)
    return by_case[near[0]] if near else None


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return `; did you mean 'x'?` with the known name that is nearest; empty where none is near."""
    near = nearest(name, known)
    return "" if near is None else f"; did you mean {near!r}?"
