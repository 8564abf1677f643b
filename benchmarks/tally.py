"""How often intervals hold the truth."""

from __future__ import annotations

import math

from skd_evaluator.metrics.statistics import Interval


class Tally:
    """How often an interval held the truth, and how wide it was."""

    def __init__(self) -> None:
        self.count = self.held = self.closed = 0
        self.width = 0.0

    def add(self, truth: float, interval: Interval | None) -> None:
        """Count one interval; a rate of exactly 0 or 1 is at the end of its own."""
        if interval is None:
            return
        low, high = interval
        self.count += 1
        self.held += low - 1e-12 <= truth <= high + 1e-12
        if math.isfinite(high - low):  # open ends have no width
            self.width += high - low
            self.closed += 1

    def __str__(self) -> str:
        """The share that held in percent, and in brackets the mean width."""
        return f"{100.0 * self.held / max(1, self.count):.1f} ({self.width / max(1, self.closed):.3f})"
