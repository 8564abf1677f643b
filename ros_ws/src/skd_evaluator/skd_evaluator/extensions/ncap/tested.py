"""What a static test says of a cell: the impact speed, and the colour of 2026 or why it has none."""

from __future__ import annotations

import math
from dataclasses import replace

from skd_evaluator.assessment.judge.static_tests import Tested
from skd_evaluator.extensions.ncap.colours import colour_of
from skd_evaluator.extensions.ncap.matrices import Criterion, MatrixPoint
from skd_evaluator.extensions.ncap.result import EXTENDED, STANDARD, Cell, rounded_kmh
from skd_evaluator.extensions.ncap.wanted import KMH, SAME

FASTER = 1.0
"""km/h by which a car may exceed the test speed: one that drives by itself may speed up before it sees anybody."""


def with_test(cell: Cell, tested: Tested, target: float, point: MatrixPoint | None, why_none: str = "") -> Cell:
    """Return a cell with what came of its static test.

    Args:
        cell: the cell.
        tested: its test.
        target: speed of the target in that, km/h.
        point: what 2026's matrix has there; None: nothing.
        why_none: why the car's own driving makes it no test; empty if it does not, or nobody looked.
    """
    if tested.aborted:
        return replace(cell, why=f"the test was aborted: {tested.aborted}")
    impact = rounded_kmh(KMH * tested.impact_speed)
    cell = replace(cell, touched=tested.touched, impact_speed=impact)
    if tested.touched and not tested.target:
        return replace(cell, why="the car touched somebody else than the target")
    if point is None:
        return cell
    fastest = KMH * tested.fastest
    if fastest > point.speed + FASTER:
        return replace(cell, why=f"the car speeds up to {fastest:.0f} km/h, which is no test at {point.speed:g} km/h")
    if why_none:
        return replace(cell, why=why_none)
    if not math.isclose(target, point.target, abs_tol=SAME):
        told = f"the test's target has {point.target:g} km/h, this one {target:.3g} km/h"
        return replace(cell, target=None, why=told)
    ahead = rounded_kmh(KMH * tested.speed_ahead)
    value = {
        Criterion.RELATIVE: rounded_kmh(impact - ahead),
        Criterion.IMPACT: impact,
        Criterion.REDUCTION: rounded_kmh(point.speed - impact),
    }[point.criterion]
    return replace(cell, value=value, colour=colour_of(point.criterion, point.speed, value))


def in_matrix(cell: Cell, point: MatrixPoint | None) -> Cell:
    """Return a cell with the range in which it is, and what its colour goes by."""
    if point is None:
        return cell
    return replace(cell, range=STANDARD if point.standard else EXTENDED, criterion=str(point.criterion))
