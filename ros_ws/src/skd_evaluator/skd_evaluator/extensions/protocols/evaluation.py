"""From scenarios and a car to the regulator's view: cells, their static tests, colours, and margins around them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from skd_sim.controllers.controller import with_control_period
from skd_sim.errors import AssessmentError, UsageError
from skd_sim.scenario.scenario import Scenario, changed_scenario, load_scenario
from skd_sim.scenario.scenario_file import REGULATORY, lineage
from skd_sim.world.dynamics.basic import clipped_line, command_limits
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome

from skd_evaluator.assessment.context import Progress
from skd_evaluator.assessment.episode_figures import StaticTest
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import Workers
from skd_evaluator.assessment.stages.checks import undisturbed_drives
from skd_evaluator.assessment.stages.margin import minimal_deviations, why_no_margin
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.assessment.stages.static_tests import static_episodes
from skd_evaluator.extensions.protocols.matrices import Criterion, ProtocolMatrix, colour_of, matrix_of
from skd_evaluator.extensions.protocols.result import Grid, GridCell
from skd_evaluator.metrics.margins import Margins

KMH = 3.6
SAME = 1e-6
"""km/h, within which two speeds are the same."""
FASTER = 1.0
"""km/h by which a car may exceed the test speed: one that drives by itself may speed up before it sees a road user."""
_ROUNDED = 6  # digits of a speed in km/h that are kept: 30 / 3.6 · 3.6 is more than 30


def rounded_kmh(speed: float) -> float:
    """Return a speed in km/h, rounded so that what was requested in km/h comes back as it was."""
    return round(speed, _ROUNDED) + 0.0  # no −0


def with_test(cell: GridCell, tested: StaticTest, target: float, why_none: str = "", braking: float = 0.0) -> GridCell:
    """Return a cell with what came of its static test.

    Args:
        cell: the cell.
        tested: its test.
        target: speed of the target in that, km/h.
        why_none: why the car's own driving makes it no test; empty if it does not, or it is not known.
        braking: the car's peak deceleration, m/s².
    """
    if tested.aborted:
        return replace(cell, why=f"the test was aborted: {tested.aborted}")
    impact = rounded_kmh(KMH * tested.impact_speed)
    cell = replace(cell, touched=tested.touched, impact_speed=impact, braking_ttc=tested.braking_ttc)
    if tested.touched and not tested.target:
        return replace(cell, why="the car touched another road user than the target")
    if not cell.criterion or cell.target is None:
        return cell
    fastest = KMH * tested.fastest
    if fastest > cell.speed + FASTER:
        return replace(cell, why=f"the car speeds up to {fastest:.0f} km/h, which is no test at {cell.speed:g} km/h")
    if why_none:
        return replace(cell, why=why_none)
    if not math.isclose(target, cell.target, abs_tol=SAME):
        said = f"the test's target has {cell.target:g} km/h, this one {target:.3g} km/h"
        return replace(cell, target=None, why=said)
    value = {
        Criterion.RELATIVE: rounded_kmh(impact - rounded_kmh(KMH * tested.speed_ahead)),
        Criterion.IMPACT: impact,
        Criterion.REDUCTION: rounded_kmh(cell.speed - impact),
        Criterion.BRAKING: round(braking, _ROUNDED) + 0.0,
    }[Criterion(cell.criterion)]
    return replace(cell, value=value, colour=colour_of(Criterion(cell.criterion), cell.speed, value, cell.limit))


def requested_tests(source: str, speeds: Sequence[float] | None) -> tuple[ProtocolMatrix | None, list[GridCell]]:
    """Return the matrix that a scenario belongs to, and its cells at some test speeds (km/h; None: the matrix's).

    Raises:
        UsageError: there is no such scenario, or it has no protocol.
    """
    scenario = load_scenario(source)
    if scenario.protocol is None:
        raise UsageError(f"scenario {source} has no section protocol, so no regulator's test is known in it")
    matrix = next((found for name in lineage(source) if (found := matrix_of(name)) is not None), None)
    points = () if matrix is None else matrix.points
    places = scenario.protocol.impact_places
    own = [rounded_kmh(KMH * scenario.car.start_speed)]
    targets = list(dict.fromkeys(one.target for one in points if one.place is None))
    cells: list[GridCell] = []
    for speed in speeds or list(dict.fromkeys(point.speed for point in points)) or own:
        here = [one for one in points if one.speed == speed and (one.place is None or one.place in places)]
        if here:
            cells += map(GridCell.of_point, here)
        elif targets:
            cells += [GridCell(speed=speed, target=one, why=why_none(matrix, speed)) for one in targets]
        else:
            cells += [GridCell(speed=speed, place=one, why=why_none(matrix, speed, one)) for one in places]
    return matrix, cells


def series_tests(series: ProtocolMatrix, speeds: Sequence[float] | None) -> list[GridCell]:
    """Return the cells of a series of a regulation at some test speeds (km/h; None: all)."""
    return [GridCell.of_point(one) for one in series.points if speeds is None or one.speed in speeds]


def why_none(matrix: ProtocolMatrix | None, speed: float, place: float = 0.0) -> str:
    """Return why a matrix has no test at a speed (km/h) and a place (%)."""
    if matrix is None:
        return "it is none of the tests of 2026"
    if speed not in {point.speed for point in matrix.points}:
        return f"{matrix.test} has no test at {speed:g} km/h"
    anywhere = any(point.place == place for point in matrix.points)
    return f"{matrix.test} has no impact place of {place:g} %{f' at {speed:g} km/h' if anywhere else ''}"


def scenario_of(source: str, test: GridCell, matrix: ProtocolMatrix | None) -> Scenario:
    """Return the scenario of a cell, with one impact place.

    The target's speed is the matrix's where that has several; a target of another speed than the only one is let be.

    Raises:
        UsageError: there is no such scenario at this speed.
    """
    scenario = changed_scenario(source, {"car.start_speed": test.speed / KMH})
    assert scenario.protocol is not None
    places, speed, target = scenario.protocol.impact_places, scenario.protocol.speed, test.target
    place = test.place if test.place is not None else places[len(places) // 2]
    changes: dict[str, Any] = {"car.start_speed": test.speed / KMH, "protocol.impact_places": [place]}
    if matrix is not None:
        changes |= matrix.changes
        if matrix.headway is not None:
            changes["protocol.headway"] = matrix.headway / (test.speed / KMH)
    several = matrix is not None and len({one.target for one in matrix.points}) > 1
    if target is not None and several and not math.isclose(KMH * speed, target, abs_tol=SAME):
        changes["protocol.speed"] = speed = target / KMH
        changes["adversary.speed"] = max(scenario.adversary.speed, speed)
    return changed_scenario(source, changes)


@dataclass(frozen=True)
class ProtocolRequest:
    """What is requested of every scenario.

    Attributes:
        plan: the car, and its trials, in whatever scenario.
        control_period: time between two decisions that the controller declares, s; None: it declares none.
        speeds: test speeds, km/h; None: those of the matrix.
        margin_limit: candidates that the search for the margin may drive in each trial; 0: no margin.
    """

    plan: Plan
    control_period: float | None
    speeds: Sequence[float] | None
    margin_limit: int


def log_warnings(logs: Sequence[EpisodeLog]) -> list[str]:
    """Return how many static tests were aborted, and how often more was commanded than the car can do, a line each."""
    found = []
    if lost := sum(log.outcome == Outcome.ABORTED for log in logs):
        found.append(f"{lost} of {len(logs)} static tests were aborted, and their cells have no colour")
    if clipped := [log for log in logs if log.clipped]:
        lows, highs = zip(*(command_limits(log.episode.scenario) for log in clipped), strict=True)
        found.append(clipped_line([log.clipped for log in clipped], min(lows), max(highs)))
    return found


def evaluated_grid(
    source: str | ProtocolMatrix, request: ProtocolRequest, runner: Workers, progress: Progress
) -> tuple[Grid, list[EpisodeLog]]:
    """Return the cells of a scenario, and the logs of their static tests.

    Args:
        source: its name, or the path of its file; or a series of a regulation.
        request: what is requested of each cell.
        runner: runs episodes and computes margins; it has been started.
        progress: called with how far the work is.

    Raises:
        UsageError: there is no such scenario.
        AssessmentError: the car fails in a static test.
    """
    matrix: ProtocolMatrix | None
    if isinstance(source, ProtocolMatrix):
        matrix, tests, name, source = source, series_tests(source, request.speeds), source.test, source.scenario
    else:
        name, (matrix, tests) = source, requested_tests(source, request.speeds)
    begun = [_begun(source, one, matrix, request) for one in tests]
    refused, logs = "", list[EpisodeLog]()
    try:
        logs = list(runner.run([episode for _, _, episode in begun if episode is not None]))
    except UsageError as error:  # what a car cannot drive it says when its first episode begins
        refused = str(error)
    left = iter(logs)
    cells: list[GridCell] = []
    for done, (cell, plan, _) in enumerate(begun, start=1):
        if plan is not None and refused:
            cell = replace(cell, why=refused, margin_why=refused)
        elif plan is not None:
            cell = _with_margin(_with_test(cell, next(left), plan, runner), plan, request, runner)
        cells.append(cell)
        progress(name, done, len(tests))
    return grid_of(name, load_scenario(source), cells, matrix), logs


def grid_of(name: str, scenario: Scenario, cells: Sequence[GridCell], matrix: ProtocolMatrix | None) -> Grid:
    """Return the grid of a scenario, which has a section `protocol`."""
    assert scenario.protocol is not None
    description = " ".join(scenario.description.split())
    if matrix is not None and matrix.paragraphs:
        source = f"{matrix.paragraphs}; target of scenario {matrix.scenario}"
        return Grid(name, f"By {matrix.paragraphs}.", tuple(cells), "", source)
    return Grid(name, description, tuple(cells), "" if matrix is None else matrix.test, scenario.protocol.source)


def _begun(
    source: str, cell: GridCell, matrix: ProtocolMatrix | None, request: ProtocolRequest
) -> tuple[GridCell, Plan | None, EpisodeSpec | None]:
    """Return a cell, its plan and its static test, if there are any."""
    try:
        scenario = scenario_of(source, cell, matrix)
        clocked = with_control_period(scenario, request.control_period, request.plan.controller)
        plan = replace(request.plan, scenario=clocked, safe=REGULATORY, safe_count=1)
        (episode,) = static_episodes(plan.scenario, plan.car)
    except UsageError as error:
        return replace(cell, why=str(error), margin_why=str(error)), None, None
    return cell, plan, episode


def _with_test(cell: GridCell, log: EpisodeLog, plan: Plan, runner: Workers) -> GridCell:
    protocol = plan.scenario.protocol
    assert protocol is not None
    why_none = "" if not cell.criterion or plan.car.is_own else _why_no_test(plan, cell.speed, runner)
    tested = StaticTest.of(protocol.impact_places[0], log)
    peak = float(-np.diff(log.car[:, 3]).min(initial=0.0)) / log.episode.scenario.time_step
    return with_test(cell, tested, KMH * protocol.speed, why_none, peak)


def _why_no_test(plan: Plan, speed: float, runner: Workers) -> str:
    """Return why a user's car does not drive as a test at a speed (km/h) has it; empty if it does."""
    try:
        slowest, *_ = undisturbed_drives(plan, runner)
    except AssessmentError as error:  # it has a static test all the same
        return f"whether the car keeps its speed undisturbed is not known: {error}"
    if not slowest.slows:
        return ""
    return f"the car slows down to {KMH * slowest.last:.0f} km/h undisturbed, which is no test at {speed:g} km/h"


def _with_margin(cell: GridCell, plan: Plan, request: ProtocolRequest, runner: Workers) -> GridCell:
    """Return a cell with the margin around its test."""
    if why := why_no_margin(plan, request.margin_limit, whole_episodes=False):
        return replace(cell, margin_why=why)
    (phi,) = safe_trajectories(plan, runner)
    episodes = [plan.episode(Mode.KAMIKAZE, 0, trial, phi) for trial in range(plan.kamikaze_count)]
    try:
        hits, search = minimal_deviations(episodes, {}, runner, lambda *_progress: None, request.margin_limit)
    except AssessmentError as error:  # a car that fails where the search leads it has a static test all the same
        return replace(cell, margin_why=f"its search ended: {error}")
    margins = Margins((tuple(hits),), plan.scenario.eta_max, search)
    return replace(
        cell,
        margin=margins.mean,
        margins=tuple(margins.values.tolist()),
        beyond=margins.beyond,
        converged=margins.converged,
    )
