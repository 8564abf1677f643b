"""The exception for an assessment that cannot be finished although it was asked for correctly."""

from __future__ import annotations


class AssessmentError(RuntimeError):
    """The assessment failed; the message is one line that says who is to blame."""


class OutOfReachError(AssessmentError):
    """What runs the episodes is gone: the car is not to blame, and no other assessment can go on there."""
