"""Points of whole matrices by Euro NCAP's own calculator, the optional extra `ncap`."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec

from skd_evaluator.ncap.matrices import encounters_of, matrix_of
from skd_evaluator.ncap.result import Grid, Points

PACKAGE = "euroncap_rating_2026"
HOW = 'points are computed by euroncap-rating-2026, which is not installed: pip install "skd[ncap]"'


def with_calculator() -> bool:
    """Return whether the calculator is installed; it is not imported."""
    return find_spec(PACKAGE) is not None


def points_of(grids: Sequence[Grid]) -> list[Points]:
    """Return the points of each matrix of which some cells are there, or why there are none.

    A matrix has points only where each of its tests has a colour: the calculator divides by those that there are, and
    half a matrix would look like a whole one.
    """
    return [_points(test, grids) for test in dict.fromkeys(grid.test for grid in grids if grid.test)]


def _points(test: str, grids: Sequence[Grid]) -> Points:
    names = encounters_of(test)
    cells = [cell for grid in grids if grid.encounter in names for cell in grid.cells if cell.colour]
    wanted = sum(len(one.points) for name in names if (one := matrix_of(name)) is not None)
    if len(cells) != wanted:
        return Points(
            test, why=f"{len(cells)} of {wanted} tests have a colour; they are those of {' and '.join(names)}"
        )
    # Slow to import, and nobody else's: only now.
    from euroncap_rating_2026.common import PredictionColor
    from euroncap_rating_2026.crash_avoidance.data_model import TOTAL_SCORES
    from euroncap_rating_2026.crash_avoidance.matrix_processing import TestPoint, TestRange
    from euroncap_rating_2026.crash_avoidance.test_info import compute_predicted_score

    tests = [
        TestPoint(0, number, PredictionColor(cell.colour), TestRange(cell.range.capitalize()))
        for number, cell in enumerate(cells)
    ]
    standard, extended = compute_predicted_score(test, tests)
    most = TOTAL_SCORES[test]
    return Points(test, float(standard), float(most["Standard"]), float(extended), float(most["Extended"]))
