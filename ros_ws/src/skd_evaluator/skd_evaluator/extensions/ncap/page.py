"""The regulator's view of results, as an HTML page of its own and as a section of reports."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Protocol

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import Scenario
from skd_sim.scenario.scenario_file import lineage

from skd_evaluator.assessment.stages.static_tests import StaticTest, place_of
from skd_evaluator.extensions.ncap.evaluation import (
    KMH,
    SAME,
    NcapTest,
    in_matrix,
    requested_tests,
    scenario_of,
    why_none,
    with_test,
)
from skd_evaluator.extensions.ncap.layout import (
    COLOURS,
    LEGEND,
    LIGHT,
    Layout,
    equivalent_text,
    headline,
    impact_text,
    layout_of,
    letter_of,
    margin_text,
    points_lines,
    reasons,
    row_name,
)
from skd_evaluator.extensions.ncap.matrices import ROOM, ProtocolMatrix, matrix_of
from skd_evaluator.extensions.ncap.result import Grid, Ncap, NcapCell, rounded_kmh
from skd_evaluator.metrics.statistics import mean
from skd_evaluator.report.formats import bounded, counted
from skd_evaluator.report.html.subjects import Subject
from skd_evaluator.report.html.template import Section, filled
from skd_evaluator.report.terminal import car_name

_OF_THE_TEST: Final = ("road", "adversary", "others", "obstacles", "protocol")
"""Sections of a scenario that make it the test of its name; the car and its speed are free."""
_BY_SPEED: Final = {
    "car": ("start_speed", "start_gap", "start_gap_range", "start_time", "start_time_range"),
    "protocol": ("speed", "impact_places"),
    "adversary": ("speed", "start_x", "start_y", "start_speed"),
}
"""Keys of a scenario's sections in which the tests of one grid may differ."""


class AssessedTests(Protocol):
    """What the view needs of a result."""

    @property
    def figures(self) -> Mapping[str, Any]:
        """Content of assessment.json."""

    @property
    def scenario(self) -> Scenario:
        """Scenario of the test."""

    @property
    def margins(self) -> Sequence[FloatArray]:
        """Per φ what each trial of the margin counts as, m; none of each where it is not known."""


@dataclass(frozen=True)
class RegulatorView:
    """The tests of one car in one scenario.

    Attributes:
        car: the car, as people read it.
        grid: its cells.
        layout: the same as a table.
        equivalent: the equivalent multiplier of each row of the table, over its φ; empty where there is none.
        said: what is to be said of it first.
        reasons: why cells have no colour or no margin, a line each.
    """

    car: str
    grid: Grid
    layout: Layout
    equivalent: tuple[str, ...]
    said: str
    reasons: tuple[str, ...]


def views_of(results: Sequence[AssessedTests], room: float) -> list[RegulatorView]:
    """Return the regulator's view of results that have static tests, a grid for each car in each scenario.

    Results that differ in test speed and seed alone make up one grid; where two have the same cell, its trials are
    those of both.

    Args:
        results: whatever results; those without static tests are not in it.
        room: margin below which a green test stands out, m.
    """
    groups: dict[str, list[AssessedTests]] = {}
    for one in results:
        if one.figures.get("static_tests"):
            groups.setdefault(_key(one), []).append(one)
    return [_view(group, room) for group in groups.values()]


def _key(one: AssessedTests) -> str:
    """Return what results of one grid have in common."""
    figures, scenario = one.figures, one.scenario.as_dict()
    for section, free in _BY_SPEED.items():
        scenario[section] = {key: value for key, value in scenario[section].items() if key not in free}
    planned = [figures[key] for key in ("knowledge", "simulations", "maximum_distance", "options")]
    return json.dumps([car_name(figures), scenario, planned], sort_keys=True, default=str)


def _view(group: Sequence[AssessedTests], room: float) -> RegulatorView:
    cells: dict[tuple[float, float | None, float | None], NcapCell] = {}
    equivalent: dict[float, str] = {}
    name, matrix = group[0].scenario.name, None
    for one in group:
        matrix, found = _cells(one)
        for cell in found:
            key = (cell.speed, cell.place, cell.target)
            cells[key] = _joined(cells[key], cell) if key in cells else cell
            equivalent[cell.speed] = bounded(one.figures, str(one.figures["equivalent_multiplier_text"] or ""))
    scenario = group[0].scenario
    assert scenario.protocol is not None
    ordered = tuple(cells[key] for key in sorted(cells, key=lambda key: tuple(entry or 0.0 for entry in key)))
    test = "" if matrix is None else matrix.test
    grid = Grid(name, " ".join(scenario.description.split()), ordered, test, scenario.protocol.source)
    speeds = dict.fromkeys(cell.speed for cell in ordered)
    layout = layout_of(grid)
    return RegulatorView(
        car_name(group[0].figures),
        grid,
        layout,
        tuple(equivalent[speed] for speed in speeds),
        headline(grid, room),
        tuple(reasons(grid)),
    )


def _cells(one: AssessedTests) -> tuple[ProtocolMatrix | None, list[NcapCell]]:
    """Return the matrix of a result's scenario, and its cells."""
    scenario, figures = one.scenario, one.figures
    assert scenario.protocol is not None
    places = [place_of(str(row["name"])) for row in figures["per_safe_trajectory"]]
    target = KMH * scenario.protocol.speed
    matrix = None
    found = []
    for entry in figures["static_tests"]:
        tested = StaticTest(**entry)
        matrix, wanted = _wanted(scenario, tested.place)
        cell = in_matrix(
            NcapCell(speed=wanted.speed, target=wanted.target, place=wanted.place, why=wanted.why), wanted.point
        )
        cell = with_test(cell, tested, target, wanted.point)
        if tested.place in places:
            cell = _with_kamikazes(cell, one, places.index(tested.place))
        found.append(cell)
    return matrix, found


def _with_kamikazes(cell: NcapCell, one: AssessedTests, index: int) -> NcapCell:
    """Return a cell with what kamikazes around its φ can do."""
    margins, figures = one.margins[index], one.figures
    cell = replace(cell, deviation=figures["per_safe_trajectory"][index]["deviation"])
    if not margins.size:
        return replace(cell, margin_why=str(figures["margin_note"]) or "no trial of it has one")
    return replace(
        cell,
        margin=mean(margins),
        margins=tuple(margins.tolist()),
        beyond=int((margins >= float(figures["eta_max"])).sum()),
        converged=bool(figures["margin_converged"]),
    )


def _joined(first: NcapCell, second: NcapCell) -> NcapCell:
    """Return a cell with the trials of two, which differ in their seed."""
    margins = (*first.margins, *second.margins)
    planned = [one for one in (first.deviation, second.deviation) if one is not None]
    return replace(
        first,
        margins=margins,
        margin=mean(np.array(margins)) if margins else None,
        beyond=first.beyond + second.beyond,
        converged=first.converged and second.converged,
        deviation=mean(np.array(planned)) if planned else None,
    )


def _wanted(scenario: Scenario, place: float) -> tuple[ProtocolMatrix | None, NcapTest]:
    """Return the matrix of a result's scenario, and which of its cells an impact place at the scenario's speed is."""
    assert scenario.protocol is not None
    speed, target = rounded_kmh(KMH * scenario.car.start_speed), KMH * scenario.protocol.speed
    bare = NcapTest(speed, place)
    try:
        known = next((name for name in lineage(scenario.name) if matrix_of(name) is not None), None)
    except UsageError:
        known = None
    if known is None:
        return None, replace(bare, why="by its name it is none of the tests of 2026")
    matrix, cells = requested_tests(known, [speed])
    for one in cells:
        if one.place == place or (one.place is None and one.target is not None and abs(one.target - target) <= SAME):
            strange = [name for name in _OF_THE_TEST if _is_other(name, scenario, scenario_of(known, one, matrix))]
            if strange:
                return matrix, replace(bare, why=f"section {strange[0]} is not that of {known}")
            return matrix, one
    return matrix, replace(bare, why=why_none(matrix, speed, place))


def _is_other(section: str, mine: Scenario, shipped: Scenario) -> bool:
    own, theirs = (one.as_dict().get(section) for one in (mine, shipped))
    if section == "protocol":
        own, theirs = ({**one, "impact_places": None} if one else one for one in (own, theirs))
    return bool(own != theirs)


def render(found: Ncap) -> str:
    """Return the page."""
    return filled(
        "skd_evaluator.extensions.ncap",
        "ncap.html.j2",
        found=found,
        grids=[(grid, layout_of(grid), headline(grid, found.room), reasons(grid)) for grid in found.grids],
        colours=COLOURS,
        light=LIGHT,
        legend=LEGEND,
        points=points_lines(found),
        letter=letter_of,
        impact=impact_text,
        margin=margin_text,
        same=equivalent_text,
        details=details,
    )


def section_of(subjects: Sequence[Subject]) -> Section | None:
    """Return the regulator's view of results that have static tests, as a section of their page; None without any."""
    views = views_of(subjects, ROOM)
    if not views:
        return None
    html = filled(
        "skd_evaluator.extensions.ncap",
        "section.html.j2",
        views=views,
        room=ROOM,
        colours=COLOURS,
        light=LIGHT,
        legend=LEGEND,
        letter=letter_of,
        impact=impact_text,
        margin=margin_text,
        details=details,
    )
    return Section("regulator", "Regulator", html)


def details(cell: NcapCell) -> str:
    """Return all that is known of a cell, for whoever points at it."""
    said = [row_name(cell)]
    if cell.range:
        said.append(f"{cell.range} range")
    if cell.value is not None:
        said.append(f"{cell.criterion} {cell.value:.1f} km/h")
    if cell.touched and not cell.impact_speed:
        said.append("the target ran into the car, which stood")
    if cell.margins:
        said.append(f"margins of the trials (m): {', '.join(f'{margin:.2f}' for margin in cell.margins)}")
    if cell.beyond:
        said.append(f"no hit was found in {cell.beyond} of {counted(len(cell.margins), 'trial')}, which count as η_max")
    if not cell.converged:
        said.append("they are upper bounds")
    if cell.deviation is not None:
        said.append(f"planned deviation {cell.deviation:.2f} m")
    if cell.equivalent_text:
        said.append(f"equivalent multiplier {bounded({'margin_converged': cell.converged}, cell.equivalent_text)}")
    said += [why for why in dict.fromkeys((cell.why, cell.margin_why)) if why]
    return "; ".join(said)
