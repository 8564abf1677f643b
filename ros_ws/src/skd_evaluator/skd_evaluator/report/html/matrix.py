"""Cars by scenarios: the matrix with which the page of a campaign begins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from skd_evaluator.report.formats import bounded, interval, number, percent
from skd_evaluator.report.html.subjects import Subject
from skd_evaluator.report.terminal import car_name


@dataclass(frozen=True)
class Cell:
    """An assessment in the matrix, as it is shown.

    Attributes:
        margin: the margin, m.
        interval: its interval by φ.
        hit: share of runs along φ that are hits.
        unsure: whether the search for the margin had not converged.
    """

    margin: str
    interval: str
    hit: str
    unsure: bool


@dataclass(frozen=True)
class Matrix:
    """Assessments by car and scenario.

    Attributes:
        scenarios: names of the columns.
        rows: name of each car, and for each scenario its assessments, which may be several or none.
    """

    scenarios: tuple[str, ...]
    rows: tuple[tuple[str, tuple[tuple[Cell, ...], ...]], ...]


def scenarios_of(subjects: Sequence[Subject]) -> list[str]:
    """Return the names of the scenarios, in the order in which they come."""
    return list(dict.fromkeys(one.scenario.name for one in subjects))


def matrix_of(subjects: Sequence[Subject]) -> Matrix | None:
    """Return the matrix; None where there are not both several cars and several scenarios."""
    cars, scenarios = list(dict.fromkeys(car_name(one.figures) for one in subjects)), scenarios_of(subjects)
    if len(cars) < 2 or len(scenarios) < 2:
        return None
    cells: dict[tuple[str, str], list[Cell]] = {}
    for one in subjects:
        cells.setdefault((car_name(one.figures), one.scenario.name), []).append(_cell(one))
    rows = tuple((car, tuple(tuple(cells.get((car, place), ())) for place in scenarios)) for car in cars)
    return Matrix(tuple(scenarios), rows)


def by_scenario(subjects: Sequence[Subject]) -> list[int]:
    """Return the places of subjects, those of one scenario together."""
    order = scenarios_of(subjects)
    return sorted(range(len(subjects)), key=lambda place: (order.index(subjects[place].scenario.name), place))


def _cell(one: Subject) -> Cell:
    figures = one.figures
    return Cell(
        bounded(figures, number(figures["margin"])),
        interval(figures["margin_ci95"]),
        percent(figures["nominal_collision_rate"]),
        figures["margin_converged"] is False,
    )
