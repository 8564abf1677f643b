"""The exception for an assessment that cannot be finished although it was asked for correctly."""

from __future__ import annotations


class AssessmentError(RuntimeError):
    """The assessment failed; the message is one line that says who is to blame."""
