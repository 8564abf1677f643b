"""The figures of a crossing that physical and simulated trials have in common, and what values they can have."""

from __future__ import annotations

import math
from dataclasses import dataclass

from skd_sim.errors import UsageError

from skd_evaluator.metrics.surrogate.braking import MOST


@dataclass(frozen=True)
class Figure:
    """A figure of a trial.

    Attributes:
        key: its name in tables and in fusion.json.
        text: its name as people read it.
        unit: of it; empty for a share.
        most: largest value that it can have: more is another unit, or no trial.
        is_rate: whether a trial has it or not: 1 or 0.
        wrong: trials in which the simulator was wrong that are added to what is seen of it. A required deceleration is
            0 where nobody comes into the other's way, and much where somebody nearly does: partly it is a yes or no, as
            a hit is, and a simulator that was right in a dozen trials will be wholly wrong in one some day.
    """

    key: str
    text: str
    unit: str
    most: float
    is_rate: bool = False
    wrong: float = 0.0


FIGURES = {
    one.key: one
    for one in (
        Figure("clearance", "least clearance", "m", 100.0),
        Figure("required_deceleration", "greatest required deceleration", "m/s²", MOST, wrong=1.0),
        Figure("hit", "nominal collision rate", "", 1.0, is_rate=True),
        Figure("margin", "margin", "m", 100.0),
    )
}


def checked_value(figure: Figure, value: float, where: str) -> float:
    """Return a value of a figure.

    Args:
        figure: what it is of.
        value: the value.
        where: file and line, for the message.

    Raises:
        UsageError: it is no finite number, or one that the figure cannot have in its unit.
    """
    unit = f" {figure.unit}" if figure.unit else ""
    if not math.isfinite(value):
        raise UsageError(f"{where}: {figure.key} must be a finite number, got {value}")
    if figure.is_rate and value not in (0.0, 1.0):
        raise UsageError(f"{where}: {figure.key} must be 1 (the car hit) or 0, got {value:g}")
    if not 0.0 <= value <= figure.most:
        raise UsageError(
            f"{where}: {figure.key} must be from 0 to {figure.most:g}{unit}, got {value:g}: is it in"
            f"{unit or ' shares'}?"
        )
    return value
