"""The exceptions for an assessment that cannot be finished although it was asked for correctly."""

from __future__ import annotations

from skd_sim.errors import AssessmentError

__all__ = ["AssessmentError", "OutOfReachError"]


class OutOfReachError(RuntimeError):
    """What runs the episodes is gone: no assessment can go on there, and the car is not the cause."""
