"""Points by Euro NCAP's own calculator (the extra `ncap`); whether a result agrees with itself, for `skd verify`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module  # it is slow to import, an extra, and nobody else's
from importlib.util import find_spec
from pathlib import Path

from skd_sim.errors import UsageError
from skd_sim.inputs.files import read_json, read_text
from skd_sim.scenario.scenario import load_scenario
from skd_sim.scenario.scenario_file import is_named

from skd_evaluator.assessment.files.verification import Verified
from skd_evaluator.extensions.ncap.matrices import matrix_of, scenarios_of
from skd_evaluator.extensions.ncap.result import (
    AT_LEAST,
    AT_MOST,
    RESULT,
    TABLE,
    Grid,
    Ncap,
    Points,
    checked,
    ncap_of,
    table_of,
)
from skd_evaluator.metrics.credibility import not_credible

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


def with_regulator(found: Verified) -> Verified:
    """Return what was found, and whether what `skd ncap` wrote agrees with itself: colours, margins, points, table."""
    path = found.folder / RESULT
    if found.problems or not path.exists():
        return found
    try:
        said = checked(ncap_of(read_json(path), str(path)), path)
        table = read_text(found.folder / TABLE).replace("\r\n", "\n")
    except UsageError as error:
        return replace(found, problems=(str(error),))
    problems, remarks = [], list(found.remarks)
    again = table_of(said).replace("\r\n", "\n")
    if table.partition("\n")[0] != again.partition("\n")[0]:
        remarks.append(f"{TABLE} has the columns of another version")
    elif table != again:
        problems.append(f"{found.folder / TABLE}: has other cells than {RESULT}")
    if with_calculator() and said.points:
        if said.points != tuple(points_of(said.grids)):
            problems.append(f"{path}: its points are not those of its colours, by Euro NCAP's calculator")
    elif said.points:
        remarks.append("points not recomputed: Euro NCAP's calculator is not installed")
    problems += _beyond(said, path)
    remarks += not_credible(said.warnings)
    remarks += _bounds(said)
    remarks.append("colours follow from impact speeds, and margins from trials; page and picture are not compared")
    return replace(found, problems=tuple(problems), remarks=tuple(remarks))


def _beyond(said: Ncap, path: Path) -> list[str]:
    """Return, a line each, in which of SKD's own scenarios other trials than those without a hit count as η_max."""
    lines = []
    for grid in said.grids:
        if not is_named(grid.scenario):
            continue
        most = load_scenario(grid.scenario).eta_max
        for cell in grid.cells:
            count = sum(margin >= most for margin in cell.margins)
            if count != cell.beyond or any(margin > most for margin in cell.margins):
                lines.append(
                    f"{path}: a cell of {grid.scenario} at {cell.speed:g} km/h says that {cell.beyond} trials have "
                    f"no hit, and {count} of its margins are η_max, {most:g} m"
                )
    return lines


def _bounds(said: Ncap) -> list[str]:
    """Return how many margins are bounds of what they say, a line for each kind."""
    cells = [cell for grid in said.grids for cell in grid.cells if cell.margin is not None]
    lines = []
    for bound, why in (
        (AT_LEAST, "lower bounds: no hit was found in some of their trials, which count as η_max"),
        (AT_MOST, "upper bounds: the search has not converged"),
    ):
        if count := sum(cell.bound == bound for cell in cells):
            lines.append(f"{count} of {len(cells)} margins are {why}")
    return lines
