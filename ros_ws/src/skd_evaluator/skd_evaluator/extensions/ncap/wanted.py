"""Which cells of a matrix a scenario has at which test speeds, and the scenario of each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import Scenario, changed_scenario, load_scenario
from skd_sim.scenario.scenario_file import lineage

from skd_evaluator.extensions.ncap.matrices import Matrix, MatrixPoint, matrix_of
from skd_evaluator.extensions.ncap.result import rounded_kmh

KMH = 3.6
SAME = 1e-6
"""km/h, within which two speeds are the same."""


@dataclass(frozen=True)
class Wanted:
    """A cell that is asked for.

    Attributes:
        speed: test speed, km/h.
        place: impact place, %; None: that of the scenario.
        target: speed of the target, km/h; None: that of the scenario.
        point: what 2026's matrix has there.
        why: why it has nothing.
    """

    speed: float
    place: float | None
    target: float | None = None
    point: MatrixPoint | None = None
    why: str = ""


def wanted_cells(source: str, speeds: Sequence[float] | None) -> tuple[Matrix | None, list[Wanted]]:
    """Return the matrix that a scenario belongs to, and its cells at some test speeds (km/h; None: the matrix's).

    Raises:
        UsageError: there is no such scenario, or it has no protocol.
    """
    scenario = load_scenario(source)
    if scenario.protocol is None:
        raise UsageError(
            f"scenario {source} has no section protocol, so no regulator's test is known in it; "
            "skd scenarios list names those that have impact places"
        )
    matrix = next((found for name in lineage(source) if (found := matrix_of(name)) is not None), None)
    points = () if matrix is None else matrix.points
    places = scenario.protocol.impact_places
    own = [rounded_kmh(KMH * scenario.car.start_speed)]
    cells: list[Wanted] = []
    for speed in speeds or list(dict.fromkeys(point.speed for point in points)) or own:
        here = [one for one in points if one.speed == speed and (one.place is None or one.place in places)]
        cells += [Wanted(speed, one.place, one.target, one) for one in here]
        if here:
            continue
        targets = list(dict.fromkeys(one.target for one in points if one.place is None))
        cells += [Wanted(speed, None, target, None, why_none(matrix, speed)) for target in targets]
        if not targets:
            cells += [Wanted(speed, place, None, None, why_none(matrix, speed, place)) for place in places]
    return matrix, cells


def why_none(matrix: Matrix | None, speed: float, place: float = 0.0) -> str:
    """Return why a matrix has no test at a speed (km/h) and a place (%)."""
    if matrix is None:
        return "it is none of the tests of 2026"
    if speed not in {point.speed for point in matrix.points}:
        return f"{matrix.test} has no test at {speed:g} km/h"
    anywhere = any(point.place == place for point in matrix.points)
    return f"{matrix.test} has no impact place of {place:g} %{f' at {speed:g} km/h' if anywhere else ''}"


def scenario_of(source: str, wanted: Wanted, matrix: Matrix | None) -> Scenario:
    """Return the scenario of a cell, with one impact place.

    The target's speed is the matrix's where that has several; a target of another speed than the only one is let be.

    Raises:
        UsageError: there is no such scenario at this speed.
    """
    scenario = changed_scenario(source, {"car.start_speed": wanted.speed / KMH})
    assert scenario.protocol is not None
    places, speed, target = scenario.protocol.impact_places, scenario.protocol.speed, wanted.target
    place = wanted.place if wanted.place is not None else places[len(places) // 2]
    changes = {"car.start_speed": wanted.speed / KMH, "protocol.impact_places": [place]}
    several = matrix is not None and len({one.target for one in matrix.points}) > 1
    if target is not None and several and not math.isclose(KMH * speed, target, abs_tol=SAME):
        changes["protocol.speed"] = speed = target / KMH
        changes["adversary.speed"] = max(scenario.adversary.speed, speed)
    return changed_scenario(source, changes)
