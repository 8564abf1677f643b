"""How often intervals hold the truth."""

from __future__ import annotations

import math
from typing import Any

from skd_evaluator.metrics.statistics import Interval, wilson_interval


class Tally:
    """How often an interval held the truth, missed it on either side, and how wide it was."""

    def __init__(self) -> None:
        self.held = self.above = self.below = self.none = self.closed = 0
        self.width = 0.0

    def add(self, truth: float, interval: Interval | None) -> None:
        """Count one interval."""
        if interval is None:
            self.none += 1
            return
        low, high = interval
        # A rate of exactly 0 or 1 is at the end of its interval.
        self.above += truth > high + 1e-12
        self.below += truth < low - 1e-12
        self.held += low - 1e-12 <= truth <= high + 1e-12
        if math.isfinite(high - low):  # open ends have no width
            self.width += high - low
            self.closed += 1

    def figures(self) -> dict[str, Any]:
        """Return the shares."""
        count = max(1, self.held + self.above + self.below)
        return {
            "held": self.held / count,
            "held_ci95": wilson_interval(self.held, count),
            "truth_above": self.above / count,
            "truth_below": self.below / count,
            "width": self.width / max(1, self.closed),
            "without": self.none,
        }
