"""The one exception for input that a user can correct."""

from __future__ import annotations


class UsageError(ValueError):
    """Bad input; the message is one line that says what is wrong, where, and what would be right."""
