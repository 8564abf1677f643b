"""The exceptions for an assessment that cannot be finished although it was asked for correctly."""

from __future__ import annotations

from skd_sim.errors import AssessmentError

__all__ = ["AssessmentError", "OutOfReachError"]


class OutOfReachError(AssessmentError):
    """What runs the episodes is gone: the car is not to blame, and no other assessment can go on there."""
