"""The regulator's view as a picture: a panel for each scenario, in the colours of 2026, each cell with its margin."""

from __future__ import annotations

import math
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from skd_evaluator import palette
from skd_evaluator.extensions.ncap.layout import (
    COLOURS,
    LIGHT,
    equivalent_text,
    impact_text,
    layout_of,
    letter_of,
    margin_text,
)
from skd_evaluator.extensions.ncap.result import Cell, Grid, Ncap
from skd_evaluator.report.drawing import save_picture

_DPI, _BESIDE = 110, 3
_WIDTH, _HEIGHT = 0.72, 0.62  # inches of a cell


def save_ncap(path: Path, found: Ncap) -> None:
    """Draw all grids."""
    layouts = [layout_of(grid) for grid in found.grids]
    across = min(_BESIDE, len(layouts))
    down = math.ceil(len(layouts) / across)
    wide = max(len(one.columns) for one in layouts) * _WIDTH + 1.1
    heights = [
        max(len(one.rows) for one in layouts[row * across : (row + 1) * across]) * _HEIGHT + 1.1 for row in range(down)
    ]
    figure = Figure(figsize=(max(6.0, across * wide), sum(heights) + 0.9), layout="constrained")
    panels = figure.subplots(down, across, squeeze=False, height_ratios=heights)
    for number, axes in enumerate(panels.flat):
        if number < len(found.grids):
            _draw(axes, found.grids[number], found.room)
        else:
            axes.set_axis_off()
    figure.suptitle(
        f"{found.car}: what a regulator's tests see, and the room around them", fontsize=11, parse_math=False
    )
    compared = any(cell.equivalent_text for grid in found.grids for cell in grid.cells)
    same = ", and C of the basic car with the same margin" if compared else ""
    figure.supxlabel(
        f"Letter: colour of 2026. Beside it the impact speed (km/h), below it the margin (m){same}.\n"
        f"Framed: green with less than {found.room:g} m of room. Not an official rating.",
        fontsize=8,
    )
    save_picture(figure, path, _DPI)


def _draw(axes: Axes, grid: Grid, room: float) -> None:
    layout = layout_of(grid)
    for y, row in enumerate(layout.rows):
        for x, cell in enumerate(row.cells):
            if cell is not None:
                _draw_cell(axes, x, y, cell, narrow=cell.is_narrow(room))
    axes.set_xlim(-0.5, len(layout.columns) - 0.5)
    axes.set_ylim(len(layout.rows) - 0.5, -0.5)  # as in the table, the slowest above
    axes.set_xticks(range(len(layout.columns)), [name.split()[0] for name in layout.columns], fontsize=8)
    axes.set_yticks(range(len(layout.rows)), [row.label for row in layout.rows], fontsize=8)
    axes.set_xlabel(f"{layout.over} ({layout.columns[0].split()[-1]})", fontsize=8)
    axes.set_ylabel("test speed (km/h)", fontsize=8)
    axes.set_title(grid.scenario, fontsize=10, parse_math=False)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)


def _draw_cell(axes: Axes, x: int, y: int, cell: Cell, *, narrow: bool) -> None:
    face = COLOURS.get(cell.colour, palette.ROAD)
    ink = "black" if cell.colour in ("", *LIGHT) else "white"
    axes.add_patch(Rectangle((x - 0.48, y - 0.48), 0.96, 0.96, fc=face, ec="none"))
    if narrow:
        axes.add_patch(Rectangle((x - 0.43, y - 0.43), 0.86, 0.86, fc="none", ec="black", lw=2.2))
    axes.text(x, y - 0.2, f"{letter_of(cell)} {impact_text(cell)}", ha="center", va="center", color=ink, fontsize=7)
    weight = "bold" if narrow else "normal"
    size = 9 if narrow else 8
    same = equivalent_text(cell)
    low = 0.08 if same else 0.18
    axes.text(x, y + low, margin_text(cell), ha="center", va="center", color=ink, fontsize=size, weight=weight)
    axes.text(x, y + 0.33, same, ha="center", va="center", color=ink, fontsize=5.5)
