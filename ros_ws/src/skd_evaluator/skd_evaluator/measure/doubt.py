"""Why figures may be those of another car, or of one that does not drive: how the warnings of it begin."""

from __future__ import annotations

from collections.abc import Iterable

DISBELIEF = "do not believe these figures: "
"""Begins a warning that makes an assessment fail."""
DOUBT = "these figures are in doubt: "
"""Begins a warning that stands wherever figures do, and with which no gate passes."""
HARDLY_DRIVES = "with nobody within a kilometre "
"""Begins a warning of a car that slows down for nobody, which a comparison repeats."""


def disbelief(warnings: Iterable[str]) -> list[str]:
    """Return those of an assessment's warnings that make it fail."""
    return [line for line in warnings if line.startswith(DISBELIEF)]


def in_doubt(warnings: Iterable[object]) -> list[str]:
    """Return those of an assessment's warnings by which its figures may be those of another car, a line each.

    A file may hold several lines in one, of which the others could pass for SKD's own.
    """
    return [" ".join(str(line).split()) for line in warnings if str(line).startswith((DISBELIEF, DOUBT))]
