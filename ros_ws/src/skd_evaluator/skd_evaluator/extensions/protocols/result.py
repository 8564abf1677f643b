"""What `skd protocol` finds, and its file `protocol.json`: written and read back by the same description.

Points by Euro NCAP's own calculator (the extra `ncap`); whether a result agrees with itself, for `skd verify`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module  # the calculator is slow to import, and an extra
from importlib.util import find_spec
from pathlib import Path
from statistics import fmean
from typing import Annotated, Any, Final

from skd_sim.errors import UsageError
from skd_sim.inputs.files import read_json
from skd_sim.inputs.model import Count, Finite, Frozen, OneOf, YesNo, limits, plain, read_model

from skd_evaluator.assessment.files.result_folder import check_unchanged
from skd_evaluator.assessment.files.verification import Verified
from skd_evaluator.extensions.protocols.matrices import (
    COLOURS,
    CRITERIA,
    GREEN,
    NCAP,
    RED,
    REGULATIONS,
    Criterion,
    MatrixPoint,
    colour_of,
    matrix_of,
    scenarios_of,
)
from skd_evaluator.metrics.aborted import not_credible

RESULT, PAGE = "protocol.json", "protocol.html"
VERSION: Final = 1
_SAME: Final = 1e-5  # km/h or m by which figures differ that were rounded

Metres = Annotated[float, limits(0.0, 1e6, "m")]


@dataclass(frozen=True, kw_only=True)
class GridCell(Frozen):
    """One test, and the margin around it. What is not known is None, or an empty text.

    Attributes:
        speed: test speed of the car, km/h.
        target: speed of the target, km/h; None: that of the scenario.
        place: impact place, % of the car's width; None: that of the scenario.
        range: of the matrix in which it is, `standard` or `extended`.
        criterion: what its colour goes by.
        limit: greatest value with which it is passed; None: 2026's colours.
        touched: whether the car touched the target.
        impact_speed: speed of the car when it did, km/h; 0 where it did not.
        braking_ttc: time to collision when the car began to brake, s.
        value: of the criterion, in its unit.
        colour: of 2026.
        why: why it has no colour.
        margin: mean of `margins`, m.
        margins: of each trial, the least deviation with which the target could have been hit, m; η_max without a hit.
        beyond: trials in which no hit was found within η_max.
        converged: whether the search for the margin has converged.
        margin_why: why there is no margin.
    """

    speed: Finite
    target: Finite | None = None
    place: Finite | None = None
    range: Annotated[str, OneOf(("", "standard", "extended"))] = ""
    criterion: Annotated[str, OneOf(("", *CRITERIA))] = ""
    limit: Finite | None = None
    touched: YesNo | None = None
    impact_speed: Finite | None = None
    braking_ttc: Finite | None = None
    value: Finite | None = None
    colour: Annotated[str, OneOf(("", *COLOURS))] = ""
    why: str = ""
    margin: Metres | None = None
    margins: tuple[Metres, ...] = ()
    beyond: Count = 0
    converged: YesNo = True
    margin_why: str = ""

    @property
    def bound(self) -> str:
        """`≤` where the search for the margin has not converged, `≥` where trials without a hit count as η_max."""
        return "" if self.margin is None else "≤" if not self.converged else "≥" if self.beyond else ""

    def is_narrow(self, room: float) -> bool:
        """Return whether it is passed with a margin less than this, m; not of one that is green though it hits."""
        return self.colour == GREEN and not self.impact_speed and self.margin is not None and self.margin < room

    @classmethod
    def of_point(cls, point: MatrixPoint) -> GridCell:
        """Return the cell of a test of a matrix, before it has run."""
        range_of = "standard" if point.standard else "extended"
        return cls(
            speed=point.speed,
            target=point.target,
            place=point.place,
            range=range_of if point.limit is None else "",
            criterion=str(point.criterion),
            limit=point.limit,
        )


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
    cells: tuple[GridCell, ...]
    test: str = ""
    source: str = ""


@dataclass(frozen=True)
class Points(Frozen):
    """Points of a matrix: those of its standard and extended range, of how many; or why it has none."""

    test: str
    standard: Finite = 0.0
    standard_most: Finite = 0.0
    extended: Finite = 0.0
    extended_most: Finite = 0.0
    why: str = ""


@dataclass(frozen=True, kw_only=True)
class ProtocolResult(Frozen):
    """The regulator's view of one car.

    Attributes:
        version: of the file.
        protocol: the protocol's name.
        skd: version of SKD.
        car: the car, as people read it.
        seed: of all draws.
        trials: for each margin.
        margin_limit: candidates that the search may drive in each trial.
        grids: one for each scenario.
        points: one for each matrix; empty where they were not computed.
        points_why: why not.
        warnings: why the car is not one that a rating is of, a line each.
    """

    version: Annotated[int, limits(VERSION, VERSION, "version of the file")] = VERSION
    protocol: Annotated[str, OneOf((NCAP, *REGULATIONS))] = NCAP
    skd: str
    car: str
    seed: Count
    trials: Count
    margin_limit: Count
    grids: tuple[Grid, ...]
    points: tuple[Points, ...] = ()
    points_why: str = ""
    warnings: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """What people call the protocol."""
        return "Euro NCAP" if self.protocol == NCAP else REGULATIONS[self.protocol][0]

    @property
    def is_failed(self) -> bool:
        """Whether it is a regulation of which a test is failed."""
        return self.protocol != NCAP and any(cell.colour == RED for grid in self.grids for cell in grid.cells)

    @property
    def verdict(self) -> str:
        """Whether a regulation is fulfilled, of the tests that were run; empty for Euro NCAP, which has points."""
        cells = [cell for grid in self.grids for cell in grid.cells]
        red, open_ = (sum(cell.colour == colour for cell in cells) for colour in (RED, ""))
        if self.protocol == NCAP or not cells:
            return ""
        said = "failed" if red else "not decided" if open_ else "passed"
        return (
            f"{said}: {len(cells) - red - open_} of {len(cells)} tests passed, {red} failed, {open_} without a verdict"
        )


def as_data(found: ProtocolResult) -> dict[str, Any]:
    """Return the result as plain data, without what is not known."""
    return plain(found, empty=(None, "", ()))


def read_protocol(folder: Path) -> ProtocolResult:
    """Read a result back from its folder.

    Raises:
        UsageError: there is none, it is of another version, was changed since it was written, its colours do not follow
            from its speeds, or its margins not from its trials.
    """
    path = folder / RESULT
    check_unchanged(folder, (RESULT,))
    data = read_json(path)
    if isinstance(data, Mapping):
        data = {key: value for key, value in data.items() if key != "provenance"}
    found = read_model(ProtocolResult, data, str(path))
    for grid in found.grids:
        for cell in grid.cells:
            if problem := _contradiction(cell, found.trials):
                raise UsageError(f"{path}: {grid.scenario} at {cell.speed:g} km/h: {problem}")
    return found


def _contradiction(cell: GridCell, trials: int) -> str:
    """Return in what a cell contradicts itself; empty: in nothing."""
    if cell.colour:
        if cell.value is None or not cell.criterion:
            return f"is {cell.colour}, and does not say of what"
        try:
            colour = colour_of(Criterion(cell.criterion), cell.speed, cell.value, cell.limit)
        except ValueError as error:
            return str(error)
        if colour != cell.colour:
            unit = Criterion(cell.criterion).unit
            return f"a {cell.criterion} of {cell.value:g} {unit} is {colour}, not {cell.colour}"
    if cell.margin is None and not cell.margins:
        return ""
    if cell.margin is None or len(cell.margins) != trials or abs(cell.margin - fmean(cell.margins)) > _SAME:
        return f"its margin is not the mean of {trials} trials"
    return ""


PACKAGE = "euroncap_rating_2026"


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
    needed = sum(len(one.points) for name in names if (one := matrix_of(name)) is not None)
    if len(cells) != needed:
        return Points(
            test, why=f"{len(cells)} of {needed} tests have a colour; they are those of {' and '.join(names)}"
        )
    modules = ("crash_avoidance.matrix_processing", "crash_avoidance.test_info", "common")
    kinds, scores, colours = (import_module(f"{PACKAGE}.{name}") for name in modules)
    tests = [
        kinds.TestPoint(0, number, colours.PredictionColor(cell.colour), kinds.TestRange(cell.range.capitalize()))
        for number, cell in enumerate(cells)
    ]
    standard, extended = scores.compute_predicted_score(test, tests)
    most = kinds.data_model.TOTAL_SCORES[test]
    return Points(test, float(standard), float(most["Standard"]), float(extended), float(most["Extended"]))


def with_regulator(found: Verified) -> Verified:
    """Return what was found, and whether what `skd protocol` wrote agrees with itself: colours, margins, points."""
    path = found.folder / RESULT
    if found.problems or not path.exists():
        return found
    try:
        said = read_protocol(found.folder)
    except UsageError as error:
        return replace(found, problems=(str(error),))
    problems, remarks = [], [*found.remarks, *not_credible(said.warnings)]
    if said.points and not with_calculator():
        remarks.append("points not recomputed: Euro NCAP's calculator is not installed")
    elif said.points and said.points != tuple(points_of(said.grids)):
        problems.append(f"{path}: its points are not those of its colours, by Euro NCAP's calculator")
    cells = [cell for grid in said.grids for cell in grid.cells if cell.margin is not None]
    for bound, why in (
        ("≥", "lower bounds: no hit was found in some of their trials, which count as η_max"),
        ("≤", "upper bounds: the search has not converged"),
    ):
        if count := sum(cell.bound == bound for cell in cells):
            remarks.append(f"{count} of {len(cells)} margins are {why}")
    remarks.append("colours follow from impact speeds, and margins from trials; the page is not compared")
    return replace(found, problems=tuple(problems), remarks=tuple(remarks))
