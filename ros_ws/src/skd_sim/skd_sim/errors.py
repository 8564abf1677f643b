"""The exceptions whose message is for the user: input that can be corrected, and an assessment that cannot go on."""

from __future__ import annotations


class UsageError(ValueError):
    """Bad input; the message is one line that says what is wrong, where, and what would be right."""


class AssessmentError(RuntimeError):
    """The assessment failed; the message is one line that says who is to blame."""


class OutOfReachError(RuntimeError):
    """What runs the episodes is gone: no assessment can go on there, and the car is not the cause."""


class NoNumberError(AssessmentError):
    """A controller has answered with something else than a finite number."""
