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
        UsageError: it is none, or is not finite. What only Python takes for a number, as `1_0` for 10 or the digits of
            other scripts, is none: in a table it is a slip of the pen.
    """
    try:
        if "_" in text or not text.isascii():
            raise ValueError
        value = float(text)
    except ValueError:
        raise UsageError(f"{what} must be a number, got {text[:40]!r}") from None
    if not math.isfinite(value):
        raise UsageError(f"{what} must be finite, got {text[:40]}")
    return value
