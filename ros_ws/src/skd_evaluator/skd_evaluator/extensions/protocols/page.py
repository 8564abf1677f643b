"""The regulator's view of results, as an HTML page of its own and as a section of reports."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import Scenario
from skd_sim.scenario.scenario_file import lineage

from skd_evaluator.assessment.episode_figures import StaticTest
from skd_evaluator.assessment.stages.static_tests import place_of
from skd_evaluator.extensions.protocols import layout
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
from skd_evaluator.extensions.protocols.matrices import ROOM, ProtocolMatrix, matrix_of
from skd_evaluator.extensions.protocols.result import Grid, GridCell, ProtocolResult
from skd_evaluator.metrics.statistics import mean
from skd_evaluator.report.html.subjects import Subject
from skd_evaluator.report.html.template import Section, filled

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
        matrix, found = _cells(one)
        cells += found
    cells.sort(key=lambda cell: (cell.speed, cell.place or 0.0, cell.target or 0.0))
    return View(str(group[0].figures["car"]), grid_of(name, group[0].scenario, cells, matrix))


def _cells(one: Subject) -> tuple[ProtocolMatrix | None, list[GridCell]]:
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
    return _filled("protocol.html.j2", views, found=found, points=layout.points_lines(found))


def section_of(subjects: Sequence[Subject]) -> Section | None:
    """Return the regulator's view of results that have static tests, as a section of their page; None without any."""
    views = views_of(subjects)
    return Section("regulator", "Regulator", _filled("section.html.j2", views)) if views else None


def _filled(template: str, views: Sequence[View], **more: object) -> str:
    return filled("skd_evaluator.extensions.protocols", template, views=views, layout=layout, room=ROOM, **more)
