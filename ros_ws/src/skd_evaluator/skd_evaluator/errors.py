"""The exception for an assessment that cannot be finished although it was asked for correctly."""

from __future__ import annotations


class AssessmentError(RuntimeError):
    """The assessment failed; the message is one line that says what caused it."""


class OutOfReachError(AssessmentError):
    """The cluster that runs the episodes is gone: no assessment can go on there, and the car is not the cause."""
