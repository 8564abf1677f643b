"""Points of whole matrices by Euro NCAP's own calculator, the optional extra `ncap`."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module  # it is slow to import, an extra, and nobody else's
from importlib.util import find_spec

from skd_evaluator.extensions.ncap.matrices import matrix_of, scenarios_of
from skd_evaluator.extensions.ncap.result import Grid, Points

PACKAGE = "euroncap_rating_2026"
HOW = (
    "they are computed by Euro NCAP's own calculator, which is not installed: python -m pip install "
    "'euroncap-rating-2026>=5.4.9,<6'"
)
_MODULES = ("crash_avoidance.matrix_processing", "crash_avoidance.test_info")


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
    names = scenarios_of(test)
    cells = [cell for grid in grids if grid.scenario in names for cell in grid.cells if cell.colour]
    wanted = sum(len(one.points) for name in names if (one := matrix_of(name)) is not None)
    if len(cells) != wanted:
        return Points(
            test, why=f"{len(cells)} of {wanted} tests have a colour; they are those of {' and '.join(names)}"
        )
    kinds, scores, colours = (import_module(f"{PACKAGE}.{name}") for name in (*_MODULES, "common"))
    tests = [
        kinds.TestPoint(0, number, colours.PredictionColor(cell.colour), kinds.TestRange(cell.range.capitalize()))
        for number, cell in enumerate(cells)
    ]
    standard, extended = scores.compute_predicted_score(test, tests)
    most = kinds.data_model.TOTAL_SCORES[test]
    return Points(test, float(standard), float(most["Standard"]), float(extended), float(most["Extended"]))
