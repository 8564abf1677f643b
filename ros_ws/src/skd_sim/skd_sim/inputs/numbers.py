"""Numbers in the texts of outside data, and of command lines."""

from __future__ import annotations

import math

from skd_sim.errors import UsageError


def whole(text: str) -> int:
    """Return the whole number that a text says.

    Raises:
        ValueError: it says none, or what only Python takes for one, as `1_0` for 10 or the digits of other scripts:
            whoever writes that has made a slip of the pen.
    """
    return int(_of_digits(text))


def real(text: str) -> float:
    """Return the number that a text says, which may be infinite or nan.

    Raises:
        ValueError: as of `whole`.
    """
    return float(_of_digits(text))


def finite_number(text: str, what: str) -> float:
    """Return the number that a text says.

    Args:
        text: as it stands in the file.
        what: it is, and where, for messages.

    Raises:
        UsageError: it is none (see `real`), or is not finite.
    """
    try:
        value = real(text)
    except ValueError:
        raise UsageError(f"{what} must be a number, got {text[:40]!r}") from None
    if not math.isfinite(value):
        raise UsageError(f"{what} must be finite, got {text[:40]}")
    return value


def _of_digits(text: str) -> str:
    if "_" in text or not text.isascii():
        raise ValueError(text)
    return text
