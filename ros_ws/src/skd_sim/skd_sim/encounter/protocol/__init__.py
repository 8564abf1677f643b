"""Tests of regulators: what their target does, and files of encounters that build upon others."""

from __future__ import annotations

from typing import Final

REGULATORY: Final = "regulatory"
"""Source of safe trajectories: what a scenario's section `protocol` prescribes for a test's target, one a place."""
