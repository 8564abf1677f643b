"""The regulator's view as one HTML page, without scripts and without any request."""

from __future__ import annotations

from collections.abc import Sequence

from skd_evaluator.extensions.ncap.colours import ROOM
from skd_evaluator.extensions.ncap.layout import (
    COLOURS,
    LEGEND,
    LIGHT,
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
from skd_evaluator.extensions.ncap.of_results import views_of
from skd_evaluator.extensions.ncap.result import Cell, Ncap
from skd_evaluator.report.formats import bounded, counted
from skd_evaluator.report.html.subjects import Subject
from skd_evaluator.report.html.template import Section, filled


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


def details(cell: Cell) -> str:
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
