"""Warnings by which the figures of an assessment are not credible, wherever they stand."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

NOT_CREDIBLE: Final = "not credible: "
"""Begins a warning with which an assessment fails, no gate passes, and nothing is compared."""
UNDISTURBED: Final = "with nobody near, "
"""Begins a warning of a car that slows down for nobody, which a comparison repeats."""


def not_credible(warnings: Iterable[object]) -> list[str]:
    """Return those of an assessment's warnings by which its figures are not credible, a line each."""
    return [line for line in in_one_line(warnings) if line.startswith(NOT_CREDIBLE)]


def in_one_line(warnings: Iterable[object]) -> list[str]:
    """Return an assessment's warnings, a line each."""
    return [" ".join(str(line).split()) for line in warnings]
