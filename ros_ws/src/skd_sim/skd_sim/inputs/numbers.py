"""Numbers in the texts of outside data."""

from __future__ import annotations

import math

from skd_sim.errors import UsageError


def finite_number(text: str, what: str) -> float:
    """Return the number that a text says.

    Args:
        text: as it stands in the file.
        what: it is, and where, for messages.

    Raises:
        UsageError: it is none, or is not finite.
    """
    try:
        value = float(text)
    except ValueError:
        raise UsageError(f"{what} must be a number, got {text[:40]!r}") from None
    if not math.isfinite(value):
        raise UsageError(f"{what} must be finite, got {text[:40]}")
    return value
