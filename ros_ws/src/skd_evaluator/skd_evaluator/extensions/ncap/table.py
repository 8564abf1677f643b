"""The regulator's view on the terminal."""

from __future__ import annotations

from rich.table import Table

from skd_evaluator.extensions.ncap.layout import (
    LEGEND,
    equivalent_text,
    headline,
    impact_text,
    layout_of,
    letter_of,
    margin_text,
    points_lines,
    reasons,
)
from skd_evaluator.extensions.ncap.result import Cell, Grid, Ncap
from skd_evaluator.report.terminal import credibility, narrow_table, print_table

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


def cell_text(cell: Cell, room: float) -> str:
    """Return a cell in few letters; one that is passed with little room is bold and has an exclamation mark."""
    mark = letter_of(cell)
    planned = "" if cell.deviation is None else f"/{cell.deviation:.2f}"
    text = f"{impact_text(cell):>3} {margin_text(cell):>5}{planned}"
    if same := equivalent_text(cell):
        text = f"{text} {same}"
    style = _STYLES.get(cell.colour)
    mark = f"[{style}]{mark}[/]" if style else mark
    return f"{mark}{text}[bold]![/]" if cell.is_narrow(room) else f"{mark}{text} "
