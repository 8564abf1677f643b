"""How a grid lies before its readers, on the terminal and on the page: rows, columns, words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from rich.table import Table

from skd_evaluator.extensions.protocols.matrices import GREEN, ROOM, Criterion
from skd_evaluator.extensions.protocols.result import Grid, GridCell, ProtocolResult
from skd_evaluator.report.formats import counted
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
