"""How a grid lies before its readers, on the terminal, in the picture and on the page: rows, columns, words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rich.table import Table

from skd_evaluator.extensions.ncap.matrices import GREEN
from skd_evaluator.extensions.ncap.result import AT_LEAST, Grid, Ncap, NcapCell
from skd_evaluator.report.formats import counted
from skd_evaluator.report.terminal import credibility, narrow_table, print_table

NOTHING = "–"
COLOURS = {"green": "#009933", "yellow": "#FFDD33", "orange": "#FF9933", "brown": "#964B00", "red": "#FF3333"}
"""As Euro NCAP's calculator has them; the letter in the cell says the same."""
LIGHT = ("green", "yellow", "orange", "red")
"""Colours on which words are black: white would have a contrast below 4.5 (WCAG 2.2)."""
LEGEND = (
    "colour of 2026 (G green, Y yellow, O orange, B brown, R red, – none), impact speed (km/h), margin (m; "
    "≥ is a lower bound: no hit was found in some trial)"
)


@dataclass(frozen=True)
class LayoutRow:
    """A test speed: its label, and a cell or None for each column."""

    label: str
    cells: tuple[NcapCell | None, ...]


@dataclass(frozen=True)
class Layout:
    """A grid as a table.

    Attributes:
        over: what the columns are.
        columns: their labels.
        rows: one for each test speed.
    """

    over: str
    columns: tuple[str, ...]
    rows: tuple[LayoutRow, ...]


def layout_of(grid: Grid) -> Layout:
    """Return the rows and columns of a grid: impact places, or target speeds where its matrix has these."""
    by_place = any(cell.place is not None for cell in grid.cells)
    keys = sorted({_key(cell, by_place=by_place) for cell in grid.cells})
    speeds = list(dict.fromkeys(cell.speed for cell in grid.cells))
    several = by_place and len({cell.target for cell in grid.cells if cell.target is not None}) > 1
    rows = []
    for speed in speeds:
        mine = {_key(cell, by_place=by_place): cell for cell in grid.cells if cell.speed == speed}
        target = next((cell.target for cell in mine.values()), None)
        behind = f" ({target:g})" if several and target is not None else ""
        rows.append(LayoutRow(f"{speed:g}{behind}", tuple(mine.get(key) for key in keys)))
    unit = "%" if by_place else "km/h"
    over = "impact place" if by_place else "target's speed"
    return Layout(over, tuple(f"{key:g} {unit}" for key in keys), tuple(rows))


def _key(cell: NcapCell, *, by_place: bool) -> float:
    found = cell.place if by_place else cell.target
    return 0.0 if found is None else found


def letter_of(cell: NcapCell) -> str:
    """Return the letter of a cell's colour."""
    return cell.colour[:1].upper() or NOTHING


def impact_text(cell: NcapCell) -> str:
    """Return a cell's impact speed."""
    return NOTHING if cell.impact_speed is None else f"{cell.impact_speed:.0f}" if cell.touched else "0"


def margin_text(cell: NcapCell) -> str:
    """Return a cell's margin: at least so much where nobody could be hit within η_max in a trial.

    A search that has not converged may have missed a hit, so that it gives no least value.
    """
    if cell.margin is None:
        return NOTHING
    return f"{'≥' if cell.bound == AT_LEAST else ''}{cell.margin:.2f}"


def equivalent_text(cell: NcapCell) -> str:
    """Return a cell's equivalent multiplier, short; empty where nobody asked for it."""
    if cell.equivalent is not None:
        return f"C {cell.equivalent:.2f}"
    return f"C {cell.equivalent_text}".replace("below ", "<").replace("above ", ">") if cell.equivalent_text else ""


def row_name(cell: NcapCell) -> str:
    """Return which cell it is."""
    beside = f"{cell.place:g} %" if cell.place is not None else f"target {cell.target or 0.0:g} km/h"
    return f"{cell.speed:g} km/h, {beside}"


def reasons(grid: Grid) -> list[str]:
    """Return why cells have no colour, no margin, or one that is too large, a line for each reason."""
    found: dict[str, list[NcapCell]] = {}
    if loose := [cell for cell in grid.cells if not cell.converged]:
        found["the search for the margin has not converged, which is an upper bound: try a greater --margin-limit"] = (
            loose
        )
    if part := [cell for cell in grid.cells if 0 < cell.beyond < len(cell.margins)]:
        found["in some trials nobody could be hit within η_max, with which they count in the margin"] = part
    if none := unfound(grid):
        found["the search found no hit in any trial: the margin stands at η_max, and was not measured"] = none
    for cell in grid.cells:
        for why in dict.fromkeys(filter(None, (cell.why, cell.margin_why and f"no margin: {cell.margin_why}"))):
            if why != f"no margin: {cell.why}":
                found.setdefault(why, []).append(cell)
    return [f"{_cells(cells, grid)}: {why}" for why, cells in found.items()]


def unfound(grid: Grid) -> list[NcapCell]:
    """Return the cells whose margin is η_max because no trial has a hit."""
    return [cell for cell in grid.cells if cell.margins and cell.beyond == len(cell.margins)]


def _cells(cells: Sequence[NcapCell], grid: Grid) -> str:
    if len(cells) == len(grid.cells) > 1:
        return "all cells"
    return row_name(cells[0]) if len(cells) == 1 else f"{len(cells)} cells, from {row_name(cells[0])}"


def narrow_ones(grid: Grid, room: float) -> list[NcapCell]:
    """Return the cells that are passed with less room (m) than wanted, those with the least first."""
    return sorted((cell for cell in grid.cells if cell.is_narrow(room)), key=lambda cell: cell.margin or 0.0)


def headline(grid: Grid, room: float) -> str:
    """Return what is to be said of a grid first, in a sentence or two."""
    coloured = [cell for cell in grid.cells if cell.colour]
    green, narrow = sum(cell.colour == GREEN for cell in coloured), narrow_ones(grid, room)
    if not coloured:
        return "No test has a colour."
    said = f"{green} of {counted(len(coloured), 'test')} {'is' if 1 in (green, len(coloured)) else 'are'} green"
    if narrow:
        least = narrow[0]
        where = f"the least is {margin_text(least)} m, at {row_name(least)}"
        return f"{said}, {len(narrow)} with less than {room:g} m of room: {where}."
    known = green and any(cell.margin is not None for cell in coloured)
    if not known:
        return f"{said}."
    safe = sum(cell.colour == GREEN for cell in unfound(grid))
    because = f"; of {safe} because no hit was found" if safe else ""
    return f"{said}, none with less than {room:g} m of room{because}."


def points_lines(found: Ncap) -> list[str]:
    """Return what is to be said of points, a line for each matrix."""
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


def print_ncap(found: Ncap) -> None:
    """Print all grids, each with what is to be said of it."""
    compared = any(cell.equivalent_text for grid in found.grids for cell in grid.cells)
    same = ", C of the basic car with the same margin" if compared else ""
    said = credibility(found.warnings)
    first = f"{said.capitalize()} (the warnings say why): {found.car}" if said else found.car
    print(f"{first}. Each cell: {LEGEND}{same}; ! green with less than {found.room:g} m of room")
    for grid in found.grids:
        beside = f" ({grid.test})" if grid.test else ""
        print(f"\n{grid.scenario}{beside}: test speed (km/h) × {layout_of(grid).over}")
        print_table(grid_table(grid, found.room))
        print(headline(grid, found.room))
        for line in reasons(grid):
            print(f"  {line}")
    print("\n" + "\n".join(points_lines(found)))


def grid_table(grid: Grid, room: float) -> Table:
    """Return the table of a grid."""
    layout = layout_of(grid)
    table = narrow_table("")
    table.title = None
    table.add_column("")
    for name in layout.columns:
        table.add_column(name, justify="right", no_wrap=True)
    for row in layout.rows:
        table.add_row(row.label, *("" if cell is None else cell_text(cell, room) for cell in row.cells))
    return table


def cell_text(cell: NcapCell, room: float) -> str:
    """Return a cell in few letters; one that is passed with little room is bold and has an exclamation mark."""
    mark = letter_of(cell)
    planned = "" if cell.deviation is None else f"/{cell.deviation:.2f}"
    text = f"{impact_text(cell):>3} {margin_text(cell):>5}{planned}"
    if same := equivalent_text(cell):
        text = f"{text} {same}"
    style = _STYLES.get(cell.colour)
    mark = f"[{style}]{mark}[/]" if style else mark
    return f"{mark}{text}[bold]![/]" if cell.is_narrow(room) else f"{mark}{text} "
