"""Numbers as the page writes them."""

from __future__ import annotations

from collections.abc import Sequence

NOTHING = "–"


def number(value: float | None, digits: int = 3, unit: str = "") -> str:
    """Return a number with so many digits after the point, and its unit."""
    if value is None:
        return NOTHING
    return f"{value:.{digits}f}{unit and ' ' + unit}".replace("-", "−")


def percent(value: float | None, digits: int = 1) -> str:
    """Return a share as a percentage."""
    return NOTHING if value is None else f"{100.0 * value:.{digits}f} %"


def interval(ends: Sequence[float] | None, digits: int = 3) -> str:
    """Return an interval."""
    return NOTHING if ends is None else f"{ends[0]:.{digits}f} to {ends[1]:.{digits}f}".replace("-", "−")


def percent_interval(ends: Sequence[float] | None, digits: int = 1) -> str:
    """Return an interval of shares, as percentages."""
    return NOTHING if ends is None else f"{100.0 * ends[0]:.{digits}f} to {100.0 * ends[1]:.{digits}f} %"


def counted(count: int, thing: str) -> str:
    """Return a number with its noun, which takes an s for all but one; thousands apart, φ as it is."""
    plural = thing if count == 1 or thing.endswith("φ") else f"{thing}s"
    return f"{count:,} {plural}"
