"""The regulator's view of results: grids on the terminal, as an HTML page and as a section of reports."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

from rich.table import Table
from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import Scenario
from skd_sim.scenario.scenario_file import lineage

from skd_evaluator.assessment.episode_figures import StaticTest
from skd_evaluator.assessment.stages.static_tests import place_of
from skd_evaluator.extensions.protocols.evaluation import (
    KMH,
    SAME,
    grid_of,
    requested_tests,
    rounded_kmh,
    scenario_of,
    why_none,
    with_test,
)
from skd_evaluator.extensions.protocols.matrices import GREEN, ROOM, Criterion, ProtocolMatrix, matrix_of
from skd_evaluator.extensions.protocols.result import Grid, GridCell, ProtocolResult
from skd_evaluator.metrics.statistics import mean
from skd_evaluator.report.formats import counted
from skd_evaluator.report.html.subjects import Subject
from skd_evaluator.report.html.template import Section, filled
from skd_evaluator.report.terminal import credibility, narrow_table, print_table

NOTHING = "–"
COLOURS = {"green": "#009933", "yellow": "#FFDD33", "orange": "#FF9933", "brown": "#964B00", "red": "#FF3333"}
"""As Euro NCAP's calculator has them; the letter in the cell says the same."""
LIGHT = ("green", "yellow", "orange", "red")
"""Colours on which words are black: white would have a contrast below 4.5 (WCAG 2.2)."""
PASS_LEGEND = "G passed, R failed, – no verdict, impact speed (km/h), margin (m; ≥ and ≤: a bound)"
LEGEND = (
    "colour of 2026 (G green, Y yellow, O orange, B brown, R red, – none), impact speed (km/h), margin "
    "(m; ≥: in some trial no hit was found, ≤: the search has not converged)"
)


class Layout(NamedTuple):
    """A grid as a table: what the columns are, their labels, and for each test speed a label and its cells."""

    over: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[GridCell | None, ...]], ...]


def layout_of(grid: Grid) -> Layout:
    """Return the rows and columns of a grid: impact places, or target speeds where its matrix has these."""
    by_place = any(cell.place is not None for cell in grid.cells)

    def key(cell: GridCell) -> float:
        return (cell.place if by_place else cell.target) or 0.0

    keys = sorted(set(map(key, grid.cells)))
    several = by_place and len({cell.target for cell in grid.cells if cell.target is not None}) > 1
    rows = []
    for speed in dict.fromkeys(cell.speed for cell in grid.cells):
        mine = {key(cell): cell for cell in grid.cells if cell.speed == speed}
        target = next(cell.target for cell in mine.values())
        behind = f" ({target:g})" if several and target is not None else ""
        rows.append((f"{speed:g}{behind}", tuple(map(mine.get, keys))))
    unit = "%" if by_place else "km/h"
    return Layout(
        "impact place" if by_place else "target's speed", tuple(f"{one:g} {unit}" for one in keys), tuple(rows)
    )


def letter_of(cell: GridCell) -> str:
    """Return the letter of a cell's colour."""
    return cell.colour[:1].upper() or NOTHING


def impact_text(cell: GridCell) -> str:
    """Return a cell's impact speed."""
    return NOTHING if cell.impact_speed is None else f"{cell.impact_speed:.0f}"


def margin_text(cell: GridCell) -> str:
    """Return a cell's margin, as the bound that it may be."""
    return NOTHING if cell.margin is None else f"{cell.bound}{cell.margin:.2f}"


def cell_name(cell: GridCell) -> str:
    """Return which cell it is."""
    beside = f"{cell.place:g} %" if cell.place is not None else f"target {cell.target or 0.0:g} km/h"
    return f"{cell.speed:g} km/h, {beside}"


def details(cell: GridCell) -> str:
    """Return the tooltip of a cell."""
    said = [cell_name(cell)]
    if cell.range:
        said.append(f"{cell.range} range")
    if cell.value is not None:
        said.append(f"{cell.criterion} {cell.value:.1f} {Criterion(cell.criterion).unit}")
    if cell.limit is not None:
        said.append(f"limit {cell.limit:.3g}")
    if cell.touched and not cell.impact_speed:
        said.append("the target ran into the car, which stood")
    if cell.braking_ttc is not None:
        said.append(f"brakes at a time to collision of {cell.braking_ttc:.1f} s")
    if cell.margins:
        said.append(f"margins of the trials (m): {', '.join(f'{margin:.2f}' for margin in cell.margins)}")
    if cell.beyond:
        said.append(f"no hit was found in {cell.beyond} of {counted(len(cell.margins), 'trial')}, which count as η_max")
    if not cell.converged:
        said.append("they are upper bounds")
    said += [why for why in dict.fromkeys((cell.why, cell.margin_why)) if why]
    return "; ".join(said)


def headline(grid: Grid) -> str:
    """Return what is to be said of a grid first, in a sentence."""
    coloured = [cell for cell in grid.cells if cell.colour]
    if not coloured:
        return "No test has a colour."
    green = [cell for cell in coloured if cell.colour == GREEN]
    are = "is green" if 1 in (len(green), len(coloured)) else "are green"
    are = "passed" if any(cell.limit is not None for cell in coloured) else are
    said = f"{len(green)} of {counted(len(coloured), 'test')} {are}"
    narrow = sorted((cell for cell in green if cell.is_narrow(ROOM)), key=lambda cell: cell.margin or 0.0)
    if narrow:
        where = f"the least is {margin_text(narrow[0])} m, at {cell_name(narrow[0])}"
        return f"{said}, {len(narrow)} with a margin below {ROOM:g} m: {where}."
    return f"{said}, none with a margin below {ROOM:g} m." if any(cell.margins for cell in green) else f"{said}."


def reasons(grid: Grid) -> list[str]:
    """Return why cells have no colour, no margin or only a bound of it, a line for each reason."""
    kinds: dict[str, Callable[[GridCell], bool]] = {
        "the search for the margin has not converged, which is an upper bound: try a larger --margin-limit": (
            lambda cell: not cell.converged
        ),
        "in some trials no hit was found within η_max, with which they count in the margin": (
            lambda cell: 0 < cell.beyond < len(cell.margins)
        ),
        "no hit was found in any trial: the margin stands at η_max, and was not measured": (
            lambda cell: 0 < cell.beyond == len(cell.margins)
        ),
    }
    found = {why: mine for why, holds in kinds.items() if (mine := [cell for cell in grid.cells if holds(cell)])}
    for cell in grid.cells:
        for why in dict.fromkeys(filter(None, (cell.why, cell.margin_why and f"no margin: {cell.margin_why}"))):
            if why != f"no margin: {cell.why}":
                found.setdefault(why, []).append(cell)
    return [f"{_cells(cells, grid)}: {why}" for why, cells in found.items()]


def _cells(cells: Sequence[GridCell], grid: Grid) -> str:
    if len(cells) == len(grid.cells) > 1:
        return "all cells"
    return cell_name(cells[0]) if len(cells) == 1 else f"{len(cells)} cells, from {cell_name(cells[0])}"


def legend_of(found: ProtocolResult) -> str:
    """Return what is in a cell."""
    return PASS_LEGEND if found.verdict else LEGEND


def points_lines(found: ProtocolResult) -> list[str]:
    """Return what is to be said of points, a line for each matrix; or the verdict."""
    if found.verdict:
        return [f"{found.title}: {found.verdict}"]
    if found.points_why:
        return [f"no points: {found.points_why}"]
    return [
        f"{one.test}: no points, for {one.why}"
        if one.why
        else f"{one.test}: {one.standard:.3f} of {one.standard_most:g} points in standard range, "
        f"{one.extended:.4f} of {one.extended_most:g} in extended range"
        for one in found.points
    ]


_STYLES = {"green": "green", "yellow": "yellow", "orange": "dark_orange", "brown": "orange4", "red": "red"}


def print_result(found: ProtocolResult) -> None:
    """Print all grids, each with what is to be said of it."""
    said = credibility(found.warnings)
    first = f"{said.capitalize()} (the warnings say why): {found.car}" if said else found.car
    print(f"{first}, {found.title}. Each cell: {legend_of(found)}; ! green with a margin below {ROOM:g} m")
    for grid in found.grids:
        layout = layout_of(grid)
        beside = f" ({grid.test or grid.source})" if found.verdict or grid.test else ""
        print(f"\n{grid.scenario}{beside}: test speed (km/h) × {layout.over}")
        print_table(grid_table(layout))
        for line in (headline(grid), *(f"  {line}" for line in reasons(grid))):
            print(line)
    print("\n" + "\n".join(points_lines(found)))


def grid_table(layout: Layout) -> Table:
    """Return the table of a grid."""
    rows = [(label, *("" if cell is None else _cell_text(cell) for cell in cells)) for label, cells in layout.rows]
    table = narrow_table("", ("", *layout.columns), rows)
    table.title = None
    return table


def _cell_text(cell: GridCell) -> str:
    """Return a cell in few letters; one that is passed with a small margin has an exclamation mark."""
    letter, style = letter_of(cell), _STYLES.get(cell.colour)
    shown = f"[{style}]{letter}[/]" if style else letter
    return f"{shown}{impact_text(cell):>3} {margin_text(cell):>5}{'[bold]![/]' if cell.is_narrow(ROOM) else ' '}"


_OF_THE_TEST: Final = ("road", "adversary", "others", "obstacles", "protocol")
"""Sections of a scenario that make it the test of its name; the car and its speed are free."""
_BY_SPEED: Final = {
    "car": ("start_speed", "start_gap", "start_gap_range", "start_time", "start_time_range"),
    "protocol": ("speed", "impact_places"),
    "adversary": ("speed", "start_x", "start_y", "start_speed"),
}
"""Keys of a scenario's sections in which the tests of one grid may differ."""


class View(NamedTuple):
    """The tests of one car in one scenario."""

    car: str
    grid: Grid


def views_of(subjects: Sequence[Subject]) -> list[View]:
    """Return the regulator's view of results that have static tests, a grid for each car in each scenario.

    Results that differ in test speed alone make up one grid.
    """
    groups: dict[str, list[Subject]] = {}
    for one in subjects:
        if one.figures.get("static_tests"):
            groups.setdefault(_key(one), []).append(one)
    return [_view(group) for group in groups.values()]


def _key(one: Subject) -> str:
    """Return what results of one grid have in common."""
    figures, scenario = one.figures, one.scenario.as_dict()
    for section, free in _BY_SPEED.items():
        scenario[section] = {key: value for key, value in scenario[section].items() if key not in free}
    return json.dumps([str(figures["car"]), figures["seed"], scenario], sort_keys=True, default=str)


def _view(group: Sequence[Subject]) -> View:
    name, matrix, cells = group[0].scenario.name, None, list[GridCell]()
    for one in group:
        matrix, found = _cells_of(one)
        cells += found
    cells.sort(key=lambda cell: (cell.speed, cell.place or 0.0, cell.target or 0.0))
    return View(str(group[0].figures["car"]), grid_of(name, group[0].scenario, cells, matrix))


def _cells_of(one: Subject) -> tuple[ProtocolMatrix | None, list[GridCell]]:
    """Return the matrix of a result's scenario, and its cells."""
    scenario, figures = one.scenario, one.figures
    assert scenario.protocol is not None
    places = [place_of(str(row["name"])) for row in figures["per_safe_trajectory"]]
    matrix, found = None, []
    for entry in figures["static_tests"]:
        tested = StaticTest(**entry)
        matrix, cell = _cell_of(scenario, tested.place)
        cell = with_test(cell, tested, KMH * scenario.protocol.speed)
        margins = one.margins[places.index(tested.place)]
        if margins.size:
            beyond = int((margins >= float(figures["eta_max"])).sum())
            converged = bool(figures["margin_converged"])
            values = tuple(margins.tolist())
            cell = replace(cell, margin=mean(margins), margins=values, beyond=beyond, converged=converged)
        else:
            cell = replace(cell, margin_why=str(figures["margin_note"]) or "no trial of it has one")
        found.append(cell)
    return matrix, found


def _cell_of(scenario: Scenario, place: float) -> tuple[ProtocolMatrix | None, GridCell]:
    """Return the matrix of a result's scenario, and which of its cells an impact place at the scenario's speed is."""
    assert scenario.protocol is not None
    speed, target = rounded_kmh(KMH * scenario.car.start_speed), KMH * scenario.protocol.speed
    bare = GridCell(speed=speed, place=place)
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


def render(found: ProtocolResult) -> str:
    """Return the page."""
    views = [View("", grid) for grid in found.grids]
    return _filled("protocol.html.j2", views, found=found, points=points_lines(found))


def section_of(subjects: Sequence[Subject]) -> Section | None:
    """Return the regulator's view of results that have static tests, as a section of their page; None without any."""
    views = views_of(subjects)
    return Section("regulator", "Regulator", _filled("section.html.j2", views)) if views else None


def _filled(template: str, views: Sequence[View], **more: object) -> str:
    words = (details, headline, impact_text, layout_of, legend_of, letter_of, margin_text, reasons)
    more |= {"colours": COLOURS, "legend": LEGEND, "light": LIGHT, "room": ROOM, **{one.__name__: one for one in words}}
    return filled("skd_evaluator.extensions.protocols", template, views=views, **more)
