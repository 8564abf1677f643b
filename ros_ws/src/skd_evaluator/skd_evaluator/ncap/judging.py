"""From encounters and a car to the regulator's view: each cell's static test, its colour, and the margin around it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from skd_adversary.safe_trajectories import REGULATORY
from skd_sim.arrays import FloatArray
from skd_sim.controllers import with_control_period
from skd_sim.encounter.known_scenarios import lineage
from skd_sim.encounter.scenario import Scenario, changed_scenario, load_scenario
from skd_sim.episode.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.errors import UsageError
from skd_sim.geometry.trajectory import Trajectory

from skd_evaluator.campaign.judge.assessment import judge
from skd_evaluator.campaign.judge.struck import ADVERSARY, speed_ahead, struck
from skd_evaluator.campaign.plan.plan import Plan, Progress, kamikaze_sets, safe_trajectories
from skd_evaluator.campaign.run.executor_runner import ExecutorRunner
from skd_evaluator.campaign.run.static_test import static_episodes
from skd_evaluator.errors import AssessmentError, OutOfReachError
from skd_evaluator.margin.assessment_margin import least_ways, why_no_margin, with_planned_hits
from skd_evaluator.margin.reference import MULTIPLIERS, reference_sweep
from skd_evaluator.margin.reference import Asked as ReferenceAsked
from skd_evaluator.measure.equivalent_multiplier import equivalent_multiplier
from skd_evaluator.measure.margins import Margins
from skd_evaluator.ncap.colours import colour_of
from skd_evaluator.ncap.matrices import Criterion, Matrix, MatrixPoint, matrix_of
from skd_evaluator.ncap.result import EXTENDED, STANDARD, Cell, Grid, rounded_kmh

KMH = 3.6
FASTER = 1.0
"""km/h by which a car may exceed the test speed: one that drives by itself may speed up before it sees anybody."""
_SAME = 1e-6  # km/h


@dataclass(frozen=True)
class Wanted:
    """A cell that is asked for.

    Attributes:
        speed: test speed, km/h.
        place: impact place, %; None: that of the encounter.
        target: speed of the target, km/h; None: that of the encounter.
        point: what 2026's matrix has there.
        why: why it has nothing.
    """

    speed: float
    place: float | None
    target: float | None = None
    point: MatrixPoint | None = None
    why: str = ""


@dataclass(frozen=True)
class Asked:
    """What is asked of every encounter.

    Attributes:
        plan: the car, and how its kamikazes are planned, in whatever scenario.
        control_period: time between two decisions that the controller declares, s; None: it declares none.
        speeds: test speeds, km/h; None: those of the matrix.
        margin_limit: ticks that the search for the margin may simulate in each attempt; 0: no margin.
        planned: whether kamikazes are planned, too.
        equivalent: whether basic cars are compared in the same attempts, too.
    """

    plan: Plan
    control_period: float | None
    speeds: Sequence[float] | None
    margin_limit: int
    planned: bool
    equivalent: bool = False


def wanted_cells(source: str, speeds: Sequence[float] | None) -> tuple[Matrix | None, list[Wanted]]:
    """Return the matrix that an encounter belongs to, and its cells at some test speeds (km/h; None: the matrix's).

    Raises:
        UsageError: there is no such encounter, or it has no protocol.
    """
    scenario = load_scenario(source)
    if scenario.protocol is None:
        raise UsageError(
            f"scenario {source} has no section protocol, so no regulator's test is known in it; "
            "skd encounters list names those that have impact places"
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
        cells += [Wanted(speed, None, target, None, _why_none(matrix, speed)) for target in targets]
        if not targets:
            cells += [Wanted(speed, place, None, None, _why_none(matrix, speed, place)) for place in places]
    return matrix, cells


def _why_none(matrix: Matrix | None, speed: float, place: float = 0.0) -> str:
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
        UsageError: there is no such encounter at this speed.
    """
    scenario = changed_scenario(source, {"car.start_speed": wanted.speed / KMH})
    assert scenario.protocol is not None
    places, speed, target = scenario.protocol.impact_places, scenario.protocol.speed, wanted.target
    place = wanted.place if wanted.place is not None else places[len(places) // 2]
    changes = {"car.start_speed": wanted.speed / KMH, "protocol.impact_places": [place]}
    several = matrix is not None and len({one.target for one in matrix.points}) > 1
    if target is not None and several and not math.isclose(KMH * speed, target, abs_tol=_SAME):
        changes["protocol.speed"] = speed = target / KMH
        changes["adversary.speed"] = max(scenario.adversary.speed, speed)
    return changed_scenario(source, changes)


def judged_grid(source: str, asked: Asked, runner: ExecutorRunner, progress: Progress) -> Grid:
    """Return the cells of an encounter.

    Args:
        source: its name, or the path of its file.
        asked: what is asked of each cell.
        runner: runs episodes and computes margins; it has been started.
        progress: called with how far the work is.

    Raises:
        UsageError: there is no such encounter.
        AssessmentError: the car fails in a static test.
    """
    matrix, wanted = wanted_cells(source, asked.speeds)
    begun = [_begun(source, one, matrix, asked) for one in wanted]
    refused = ""
    try:
        logs = iter(list(runner.run([episode for _, _, episode in begun if episode is not None])))
    except UsageError as error:  # what a car cannot drive it says when its first episode begins
        refused = str(error)
    cells: list[Cell] = []
    for done, ((cell, plan, _), one) in enumerate(zip(begun, wanted, strict=True), start=1):
        if plan is not None and refused:
            cell = replace(cell, why=refused, margin_why=refused)
        elif plan is not None:
            cell = _with_margin(_with_test(cell, next(logs), one.point), plan, asked, runner)
        cells.append(cell)
        progress(source, done, len(wanted))
    scenario = load_scenario(source)
    assert scenario.protocol is not None
    test = "" if matrix is None else matrix.test
    return Grid(source, " ".join(scenario.description.split()), tuple(cells), test, scenario.protocol.source)


def _begun(
    source: str, wanted: Wanted, matrix: Matrix | None, asked: Asked
) -> tuple[Cell, Plan | None, Episode | None]:
    """Return an empty cell, its plan and its static test, if there are any."""
    point = wanted.point
    cell = Cell(speed=wanted.speed, target=wanted.target, place=wanted.place, why=wanted.why)
    if point is not None:
        cell = replace(cell, range=STANDARD if point.standard else EXTENDED, criterion=str(point.criterion))
    try:
        scenario = scenario_of(source, wanted, matrix)
        clocked = with_control_period(scenario, asked.control_period, asked.plan.controller)
        plan = replace(asked.plan, scenario=clocked, safe=REGULATORY, safe_count=1)
        (episode,) = static_episodes(plan.scenario, plan.car)
    except UsageError as error:
        return replace(cell, why=str(error), margin_why=str(error)), None, None
    return cell, plan, episode


def _with_test(cell: Cell, log: EpisodeLog, point: MatrixPoint | None) -> Cell:
    """Return a cell with what came of its static test."""
    if log.outcome == Outcome.ABORTED:
        return replace(cell, why=f"the test was aborted: {log.reason}")
    scenario = log.episode.scenario
    assert scenario.protocol is not None
    touched = log.outcome == Outcome.COLLISION
    impact = rounded_kmh(KMH * log.impact_speed) if touched else 0.0
    cell = replace(cell, touched=touched, impact_speed=impact)
    if touched and struck(log) != ADVERSARY:
        return replace(cell, why="the car touched somebody else than the target")
    if point is None:
        return cell
    fastest = KMH * float(log.car[:, 2].max())
    if fastest > point.speed + FASTER:
        return replace(cell, why=f"the car speeds up to {fastest:.0f} km/h, which is no test at {point.speed:g} km/h")
    if not math.isclose(KMH * scenario.protocol.speed, point.target, abs_tol=_SAME):
        told = f"the test's target has {point.target:g} km/h, this one {KMH * scenario.protocol.speed:.3g} km/h"
        return replace(cell, target=None, why=told)
    ahead = rounded_kmh(KMH * speed_ahead(log)) if touched else 0.0
    value = {
        Criterion.RELATIVE: rounded_kmh(impact - ahead),
        Criterion.IMPACT: impact,
        Criterion.REDUCTION: rounded_kmh(point.speed - impact),
    }[point.criterion]
    return replace(cell, value=value, colour=colour_of(point.criterion, point.speed, value))


def _with_margin(cell: Cell, plan: Plan, asked: Asked, runner: ExecutorRunner) -> Cell:
    """Return a cell with the margin around its test and, if that was asked for, what planned kamikazes needed."""
    (phi,) = safe_trajectories(plan, runner)
    logs: list[EpisodeLog] = []
    try:
        if asked.planned:
            sets = kamikaze_sets(plan, [phi], runner)
            logs = sets[0].in_order
            cell = replace(cell, deformation=judge(plan, [phi], sets, (), 0.0).deformation.mean)
        if why := why_no_margin(plan, asked.margin_limit):
            return replace(cell, margin_why=why)
        episodes = [plan.episode(Mode.KAMIKAZE, 0, attempt, phi) for attempt in range(plan.kamikaze_count)]
        by_id = {log.episode.episode_id: [log] for log in logs}

        def planned() -> list[list[FloatArray]]:
            hits = [[log for log in by_id.get(one.episode_id, ()) if log.hit] for one in episodes]
            return [[log.trajectory.positions for log in found] for found in hits]

        found = least_ways(episodes, planned, runner, lambda *_told: None, asked.margin_limit)
        ways, _ = with_planned_hits(episodes, found.ways, by_id)
    except OutOfReachError:
        raise
    except AssessmentError as error:  # a car that fails where kamikazes lead it has a static test all the same
        return replace(cell, margin_why=f"its search ended: {error}")
    margins = Margins((tuple(ways),), plan.scenario.eta_max, found.budget, found.converged)
    if asked.equivalent:
        cell = _with_equivalent(cell, plan, margins, phi, asked, runner)
    return replace(
        cell,
        margin=margins.mean,
        margins=tuple(margins.values.tolist()),
        beyond=margins.beyond,
        converged=margins.converged,
    )


def _with_equivalent(
    cell: Cell, plan: Plan, margins: Margins, phi: Trajectory, asked: Asked, runner: ExecutorRunner
) -> Cell:
    """Return a cell with the C of the basic car that has its margin, in the same attempts and by the same search."""
    where = ReferenceAsked("", plan, [phi])
    swept = reference_sweep(where, MULTIPLIERS, runner, lambda *_told: None, asked.margin_limit)
    found = equivalent_multiplier(margins.per_phi, {one: basic.per_phi for one, basic in swept.items()})
    return replace(cell, equivalent=found.value if math.isfinite(found.value) else None, equivalent_text=found.text)
