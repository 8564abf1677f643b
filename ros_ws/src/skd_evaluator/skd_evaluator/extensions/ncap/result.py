"""What `skd ncap` finds, and its file `ncap.json`: written and read back by the same description.

Points by Euro NCAP's own calculator (the extra `ncap`); whether a result agrees with itself, for `skd verify`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module  # it is slow to import, an extra, and nobody else's
from importlib.util import find_spec
from pathlib import Path
from statistics import fmean
from typing import Annotated, Any, Final

from skd_sim.errors import UsageError
from skd_sim.inputs.files import read_json
from skd_sim.inputs.model import Frozen, OneOf, YesNo, limits, read_model

from skd_evaluator.assessment.files.result_folder import hold, read_manifest
from skd_evaluator.assessment.files.verification import Verified
from skd_evaluator.extensions.ncap.matrices import (
    COLOURS,
    CRITERIA,
    GREEN,
    Criterion,
    colour_of,
    matrix_of,
    scenarios_of,
)
from skd_evaluator.metrics.aborted import not_credible

RESULT, PAGE = "ncap.json", "ncap.html"
VERSION: Final = 1
STANDARD, EXTENDED = RANGES = ("standard", "extended")
AT_LEAST, AT_MOST = "at least", "at most"
_SAME: Final = 1e-5  # km/h or m by which figures differ that were rounded
_ROUNDED: Final = 6  # digits of a speed in km/h that are kept: 30 / 3.6 · 3.6 is more than 30

KmH = Annotated[float, limits(-400.0, 400.0, "km/h")]
Metres = Annotated[float, limits(0.0, 1e6, "m")]
Count = Annotated[int, limits(0, 2**53, "a number of things")]


@dataclass(frozen=True, kw_only=True)
class NcapCell(Frozen):
    """One test, and what kamikazes around it can do. What is not known is None, or an empty text.

    Attributes:
        speed: test speed of the car, km/h.
        target: speed of the target, km/h; None: that of the scenario.
        place: impact place, % of the car's width; None: that of the scenario.
        range: of the matrix in which it is, `standard` or `extended`.
        criterion: what its colour goes by.
        touched: whether the car touched the target.
        impact_speed: speed of the car when it did, km/h; 0 where it did not.
        value: of the criterion, km/h.
        colour: of 2026.
        why: why it has no colour.
        margin: mean over the trials of the least deviation with which anybody could have been hit, m.
        margins: that of each trial, m; η_max where nobody could have been.
        beyond: trials in which nobody could have been hit within η_max, as far as was found.
        converged: whether the search for the margin has converged.
        margin_is: `at least` where trials without a hit count as η_max in the margin, `at most` where the search has
            not converged; empty: neither.
        margin_why: why there is no margin.
        deviation: mean deviation of planned kamikazes, m; a trial that failed counts as η_max.
        equivalent: C of the basic car that has the same margin in these trials; None: beyond those compared.
        equivalent_text: the same as people read it, `below 0.5` or `above 1.5` where it is beyond.
    """

    speed: KmH
    target: KmH | None = None
    place: Annotated[float, limits(-100.0, 200.0, "% of the car's width")] | None = None
    range: Annotated[str, OneOf(("", *RANGES))] = ""
    criterion: Annotated[str, OneOf(("", *CRITERIA))] = ""
    touched: YesNo | None = None
    impact_speed: KmH | None = None
    value: KmH | None = None
    colour: Annotated[str, OneOf(("", *COLOURS))] = ""
    why: str = ""
    margin: Metres | None = None
    margins: tuple[Metres, ...] = ()
    beyond: Count = 0
    converged: YesNo = True
    margin_is: Annotated[str, OneOf(("", AT_LEAST, AT_MOST))] = ""
    margin_why: str = ""
    deviation: Metres | None = None
    equivalent: Annotated[float, limits(0.0, 100.0, "times the braking distance")] | None = None
    equivalent_text: str = ""

    @property
    def bound(self) -> str:
        """What the margin is a bound of, as `margin_is` has it, whatever a file says."""
        if self.margin is None:
            return ""
        return AT_MOST if not self.converged else AT_LEAST if self.beyond else ""

    def is_narrow(self, room: float) -> bool:
        """Return whether it is passed with less room (m) than wanted; not of one that is green though it hits."""
        return self.colour == GREEN and not self.impact_speed and self.margin is not None and self.margin < room


@dataclass(frozen=True)
class Grid(Frozen):
    """The tests of one scenario.

    Attributes:
        scenario: its name, or the path of its file.
        description: what happens in it.
        cells: row by row.
        test: the matrix of 2026 that it belongs to; empty: none.
        source: where the numbers of its target come from.
    """

    scenario: str
    description: str
    cells: tuple[NcapCell, ...]
    test: str = ""
    source: str = ""


@dataclass(frozen=True)
class Points(Frozen):
    """Points of a matrix.

    Attributes:
        test: the matrix.
        standard: points of its standard range.
        standard_most: most that there are.
        extended: points of its extended range.
        extended_most: most that there are.
        why: why it has none; then the others are 0.
    """

    test: str
    standard: Annotated[float, limits(0.0, 100.0, "points")] = 0.0
    standard_most: Annotated[float, limits(0.0, 100.0, "points")] = 0.0
    extended: Annotated[float, limits(0.0, 100.0, "points")] = 0.0
    extended_most: Annotated[float, limits(0.0, 100.0, "points")] = 0.0
    why: str = ""


@dataclass(frozen=True, kw_only=True)
class Ncap(Frozen):
    """The regulator's view of one car.

    Attributes:
        ncap: version of the file.
        skd: version of SKD.
        car: the car, as people read it.
        seed: of all draws.
        trials: for each margin.
        margin_limit: candidates that the search may drive in each trial.
        room: margin below which a green test stands out, m.
        grids: one for each scenario.
        points: one for each matrix; empty where nobody computed any.
        points_why: why nobody did.
        warnings: why the car is not one that a rating is of, a line each.
    """

    ncap: Annotated[int, limits(VERSION, VERSION, "version of the file")] = VERSION
    skd: str
    car: str
    seed: Count
    trials: Count
    margin_limit: Count
    room: Metres
    grids: tuple[Grid, ...]
    points: tuple[Points, ...] = ()
    points_why: str = ""
    warnings: tuple[str, ...] = ()


def rounded_kmh(speed: float) -> float:
    """Return a speed in km/h, rounded so that what was asked for in km/h comes back as it was."""
    return round(speed, _ROUNDED) + 0.0  # no −0


def as_data(found: Ncap) -> dict[str, Any]:
    """Return the result as plain data, without what is not known."""
    known: dict[str, Any] = _known(dataclasses.asdict(found))
    return known


def _known(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _known(one) for key, one in value.items() if one is not None and one != "" and one != ()}
    return [_known(one) for one in value] if isinstance(value, (list, tuple)) else value


def read_ncap(folder: Path) -> Ncap:
    """Read a result back from its folder.

    Raises:
        UsageError: there is none, it is of another version, was changed since it was written, its colours do not follow
            from its speeds, or it contradicts itself otherwise.
    """
    path = folder / RESULT
    manifest = read_manifest(folder)
    if manifest is not None and RESULT in (held := hold(folder, manifest)).changed:
        raise UsageError(f"{path}: was changed since it was written; {len(held.same)} other files were not")
    return checked(ncap_of(read_json(path), str(path)), path)


def checked(found: Ncap, path: Path) -> Ncap:
    """Return a result whose colours follow from its speeds, margins from its trials, and bounds from its search.

    Raises:
        UsageError: one does not.
    """
    for grid in found.grids:
        for cell in grid.cells:
            where = f"{path}: {grid.scenario} at {cell.speed:g} km/h"
            if cell.colour:
                _check_colour(cell, where)
            if cell.margin is not None or cell.margins:
                _check_margin(cell, found.trials, where)
    return found


def ncap_of(data: Any, where: str) -> Ncap:
    """Return the result that plain data hold; `provenance` is not part of it."""
    if isinstance(data, Mapping):
        data = {key: value for key, value in data.items() if key != "provenance"}
    return read_model(Ncap, data, where)


def _check_colour(cell: NcapCell, where: str) -> None:
    if cell.value is None or not cell.criterion:
        raise UsageError(f"{where}: is {cell.colour}, and does not say of what")
    try:
        colour = colour_of(Criterion(cell.criterion), cell.speed, cell.value)
    except ValueError as error:
        raise UsageError(f"{where}: {error}") from error
    if colour != cell.colour:
        raise UsageError(f"{where}: a {cell.criterion} of {cell.value:g} km/h is {colour}, not {cell.colour}")


def _check_margin(cell: NcapCell, trials: int, where: str) -> None:
    if cell.margin is None or not cell.margins or abs(cell.margin - fmean(cell.margins)) > _SAME:
        said = "no margin" if cell.margin is None else f"a margin of {cell.margin:g} m"
        raise UsageError(f"{where}: has {said}, which is no mean of those of its trials")
    if len(cell.margins) != trials:
        raise UsageError(f"{where}: has margins of {len(cell.margins)} trials, and there were {trials}")
    if cell.margin_is not in ("", cell.bound):
        raise UsageError(f"{where}: its margin is {cell.margin_is} what it says, which does not follow from its search")


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
    """Return what was found, and whether what `skd ncap` wrote agrees with itself: colours, margins, points."""
    path = found.folder / RESULT
    if found.problems or not path.exists():
        return found
    try:
        said = checked(ncap_of(read_json(path), str(path)), path)
    except UsageError as error:
        return replace(found, problems=(str(error),))
    problems, remarks = [], list(found.remarks)
    if with_calculator() and said.points:
        if said.points != tuple(points_of(said.grids)):
            problems.append(f"{path}: its points are not those of its colours, by Euro NCAP's calculator")
    elif said.points:
        remarks.append("points not recomputed: Euro NCAP's calculator is not installed")
    remarks += not_credible(said.warnings)
    remarks += _bounds(said)
    remarks.append("colours follow from impact speeds, and margins from trials; the page is not compared")
    return replace(found, problems=tuple(problems), remarks=tuple(remarks))


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
