"""From scenarios and a car to the regulator's view: cells, their static tests, colours, and margins around them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from skd_sim.controllers import with_control_period
from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import Scenario, changed_scenario, load_scenario
from skd_sim.scenario.scenario_file import REGULATORY, lineage
from skd_sim.world.dynamics.basic import clipped_line, command_limits
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.context import Progress
from skd_evaluator.assessment.objective_result import objective_result
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import Workers
from skd_evaluator.assessment.stages.checks import undisturbed_drives
from skd_evaluator.assessment.stages.kamikazes import kamikaze_sets
from skd_evaluator.assessment.stages.margin import minimal_deviations, why_no_margin, with_planned_hits
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.assessment.stages.static_tests import StaticTest, static_episodes
from skd_evaluator.errors import AssessmentError, OutOfReachError
from skd_evaluator.extensions.ncap.matrices import Criterion, MatrixPoint, ProtocolMatrix, colour_of, matrix_of
from skd_evaluator.extensions.ncap.result import EXTENDED, STANDARD, Grid, NcapCell, rounded_kmh
from skd_evaluator.margin.basic_margins import yardstick
from skd_evaluator.metrics.equivalent_multiplier import equivalent_multiplier
from skd_evaluator.metrics.margins import Margins

FASTER = 1.0
"""km/h by which a car may exceed the test speed: one that drives by itself may speed up before it sees anybody."""


def with_test(
    cell: NcapCell, tested: StaticTest, target: float, point: MatrixPoint | None, why_none: str = ""
) -> NcapCell:
    """Return a cell with what came of its static test.

    Args:
        cell: the cell.
        tested: its test.
        target: speed of the target in that, km/h.
        point: what 2026's matrix has there; None: nothing.
        why_none: why the car's own driving makes it no test; empty if it does not, or nobody looked.
    """
    if tested.aborted:
        return replace(cell, why=f"the test was aborted: {tested.aborted}")
    impact = rounded_kmh(KMH * tested.impact_speed)
    cell = replace(cell, touched=tested.touched, impact_speed=impact)
    if tested.touched and not tested.target:
        return replace(cell, why="the car touched somebody else than the target")
    if point is None:
        return cell
    fastest = KMH * tested.fastest
    if fastest > point.speed + FASTER:
        return replace(cell, why=f"the car speeds up to {fastest:.0f} km/h, which is no test at {point.speed:g} km/h")
    if why_none:
        return replace(cell, why=why_none)
    if not math.isclose(target, point.target, abs_tol=SAME):
        told = f"the test's target has {point.target:g} km/h, this one {target:.3g} km/h"
        return replace(cell, target=None, why=told)
    ahead = rounded_kmh(KMH * tested.speed_ahead)
    value = {
        Criterion.RELATIVE: rounded_kmh(impact - ahead),
        Criterion.IMPACT: impact,
        Criterion.REDUCTION: rounded_kmh(point.speed - impact),
    }[point.criterion]
    return replace(cell, value=value, colour=colour_of(point.criterion, point.speed, value))


def in_matrix(cell: NcapCell, point: MatrixPoint | None) -> NcapCell:
    """Return a cell with the range in which it is, and what its colour goes by."""
    if point is None:
        return cell
    return replace(cell, range=STANDARD if point.standard else EXTENDED, criterion=str(point.criterion))


KMH = 3.6
SAME = 1e-6
"""km/h, within which two speeds are the same."""


@dataclass(frozen=True)
class NcapTest:
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


def requested_tests(source: str, speeds: Sequence[float] | None) -> tuple[ProtocolMatrix | None, list[NcapTest]]:
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
    cells: list[NcapTest] = []
    for speed in speeds or list(dict.fromkeys(point.speed for point in points)) or own:
        here = [one for one in points if one.speed == speed and (one.place is None or one.place in places)]
        cells += [NcapTest(speed, one.place, one.target, one) for one in here]
        if here:
            continue
        targets = list(dict.fromkeys(one.target for one in points if one.place is None))
        cells += [NcapTest(speed, None, target, None, why_none(matrix, speed)) for target in targets]
        if not targets:
            cells += [NcapTest(speed, place, None, None, why_none(matrix, speed, place)) for place in places]
    return matrix, cells


def why_none(matrix: ProtocolMatrix | None, speed: float, place: float = 0.0) -> str:
    """Return why a matrix has no test at a speed (km/h) and a place (%)."""
    if matrix is None:
        return "it is none of the tests of 2026"
    if speed not in {point.speed for point in matrix.points}:
        return f"{matrix.test} has no test at {speed:g} km/h"
    anywhere = any(point.place == place for point in matrix.points)
    return f"{matrix.test} has no impact place of {place:g} %{f' at {speed:g} km/h' if anywhere else ''}"


def scenario_of(source: str, test: NcapTest, matrix: ProtocolMatrix | None) -> Scenario:
    """Return the scenario of a cell, with one impact place.

    The target's speed is the matrix's where that has several; a target of another speed than the only one is let be.

    Raises:
        UsageError: there is no such scenario at this speed.
    """
    scenario = changed_scenario(source, {"car.start_speed": test.speed / KMH})
    assert scenario.protocol is not None
    places, speed, target = scenario.protocol.impact_places, scenario.protocol.speed, test.target
    place = test.place if test.place is not None else places[len(places) // 2]
    changes = {"car.start_speed": test.speed / KMH, "protocol.impact_places": [place]}
    several = matrix is not None and len({one.target for one in matrix.points}) > 1
    if target is not None and several and not math.isclose(KMH * speed, target, abs_tol=SAME):
        changes["protocol.speed"] = speed = target / KMH
        changes["adversary.speed"] = max(scenario.adversary.speed, speed)
    return changed_scenario(source, changes)


@dataclass(frozen=True)
class NcapRequest:
    """What is asked of every scenario.

    Attributes:
        plan: the car, and how its kamikazes are planned, in whatever scenario.
        control_period: time between two decisions that the controller declares, s; None: it declares none.
        speeds: test speeds, km/h; None: those of the matrix.
        margin_limit: candidates that the search for the margin may drive in each trial; 0: no margin.
        planned: whether kamikazes are planned, too.
        equivalent: whether basic cars are compared in the same trials, too.
    """

    plan: Plan
    control_period: float | None
    speeds: Sequence[float] | None
    margin_limit: int
    planned: bool
    equivalent: bool = False


@dataclass
class NcapLogs:
    """What a car has done in all scenarios.

    Attributes:
        tests: its static tests.
        kamikazes: episodes in which somebody planned to be hit.
    """

    tests: list[EpisodeLog] = field(default_factory=list)
    kamikazes: list[EpisodeLog] = field(default_factory=list)

    @property
    def warnings(self) -> list[str]:
        """How many episodes were aborted, and how often the car asked for more than it can do, a line each."""
        found = []
        for what, logs, follows in (
            ("static tests", self.tests, "their cells have no colour"),
            ("kamikazes", self.kamikazes, "they count for nothing"),
        ):
            if lost := sum(log.outcome == Outcome.ABORTED for log in logs):
                found.append(f"{lost} of {len(logs)} {what} were aborted, and {follows}")
        clipped = [log for log in (*self.tests, *self.kamikazes) if log.clipped]
        if clipped:
            lows, highs = zip(*(command_limits(log.episode.scenario) for log in clipped), strict=True)
            found.append(clipped_line([log.clipped for log in clipped], min(lows), max(highs)))
        return found


def evaluated_grid(source: str, request: NcapRequest, runner: Workers, progress: Progress, seen: NcapLogs) -> Grid:
    """Return the cells of a scenario.

    Args:
        source: its name, or the path of its file.
        request: what is asked of each cell.
        runner: runs episodes and computes margins; it has been started.
        progress: called with how far the work is.
        seen: what happens is added to it.

    Raises:
        UsageError: there is no such scenario.
        AssessmentError: the car fails in a static test.
    """
    matrix, tests = requested_tests(source, request.speeds)
    begun = [_begun(source, one, matrix, request) for one in tests]
    refused, done_tests = "", list[EpisodeLog]()
    try:
        done_tests = list(runner.run([episode for _, _, episode in begun if episode is not None]))
    except UsageError as error:  # what a car cannot drive it says when its first episode begins
        refused = str(error)
    seen.tests += done_tests
    logs = iter(done_tests)
    cells: list[NcapCell] = []
    for done, ((cell, plan, _), one) in enumerate(zip(begun, tests, strict=True), start=1):
        if plan is not None and refused:
            cell = replace(cell, why=refused, margin_why=refused)
        elif plan is not None:
            cell = _with_margin(_with_test(cell, next(logs), plan, one.point, runner), plan, request, runner, seen)
        cells.append(cell)
        progress(source, done, len(tests))
    scenario = load_scenario(source)
    assert scenario.protocol is not None
    test = "" if matrix is None else matrix.test
    return Grid(source, " ".join(scenario.description.split()), tuple(cells), test, scenario.protocol.source)


def _begun(
    source: str, test: NcapTest, matrix: ProtocolMatrix | None, request: NcapRequest
) -> tuple[NcapCell, Plan | None, EpisodeSpec | None]:
    """Return an empty cell, its plan and its static test, if there are any."""
    cell = in_matrix(NcapCell(speed=test.speed, target=test.target, place=test.place, why=test.why), test.point)
    try:
        scenario = scenario_of(source, test, matrix)
        clocked = with_control_period(scenario, request.control_period, request.plan.controller)
        plan = replace(request.plan, scenario=clocked, safe=REGULATORY, safe_count=1)
        (episode,) = static_episodes(plan.scenario, plan.car)
    except UsageError as error:
        return replace(cell, why=str(error), margin_why=str(error)), None, None
    return cell, plan, episode


def _with_test(cell: NcapCell, log: EpisodeLog, plan: Plan, point: MatrixPoint | None, runner: Workers) -> NcapCell:
    protocol = plan.scenario.protocol
    assert protocol is not None
    why_none = "" if point is None or plan.car.is_own else _why_no_test(plan, point.speed, runner)
    return with_test(cell, StaticTest.of(protocol.impact_places[0], log), KMH * protocol.speed, point, why_none)


def _why_no_test(plan: Plan, speed: float, runner: Workers) -> str:
    """Return why a user's car does not drive as a test at a speed (km/h) has it; empty if it does."""
    try:
        slowest, *_ = undisturbed_drives(plan, runner)
    except OutOfReachError:
        raise
    except AssessmentError as error:  # it has a static test all the same
        return f"whether the car keeps its speed with nobody near cannot be told: {error}"
    if not slowest.slows:
        return ""
    return f"the car slows down to {KMH * slowest.last:.0f} km/h with nobody near, which is no test at {speed:g} km/h"


def _with_margin(cell: NcapCell, plan: Plan, request: NcapRequest, runner: Workers, seen: NcapLogs) -> NcapCell:
    """Return a cell with the margin around its test and, if that was asked for, what planned kamikazes needed."""
    (phi,) = safe_trajectories(plan, runner)
    logs: list[EpisodeLog] = []
    try:
        if request.planned:
            sets = kamikaze_sets(plan, [phi], runner)
            logs = sets[0].in_order
            seen.kamikazes += logs
            cell = replace(cell, deviation=objective_result(plan, sets).deviation.mean)
        if why := why_no_margin(plan, request.margin_limit, whole_episodes=False):
            return replace(cell, margin_why=why)
        episodes = [plan.episode(Mode.KAMIKAZE, 0, trial, phi) for trial in range(plan.kamikaze_count)]
        by_id = {log.episode.episode_id: [log] for log in logs}
        found, search = minimal_deviations(episodes, by_id, runner, lambda *_told: None, request.margin_limit)
        hits, _ = with_planned_hits(episodes, found, by_id)
    except OutOfReachError:
        raise
    except AssessmentError as error:  # a car that fails where kamikazes lead it has a static test all the same
        return replace(cell, margin_why=f"its search ended: {error}")
    margins = Margins((tuple(hits),), plan.scenario.eta_max, search)
    if request.equivalent:
        cell = _with_equivalent(cell, plan, margins, phi, request, runner)
    searched = replace(
        cell,
        margin=margins.mean,
        margins=tuple(margins.values.tolist()),
        beyond=margins.beyond,
        converged=margins.converged,
    )
    return replace(searched, margin_is=searched.bound)


_MULTIPLIERS = (0.5, 0.75, 1.0, 1.25, 1.5)


def _basic_margins(plan: Plan, phi: Trajectory, request: NcapRequest, runner: Workers) -> Margins:
    """Return the margins of a basic car along one φ, found by the same search as the car's."""
    episodes = [plan.episode(Mode.KAMIKAZE, 0, trial, phi) for trial in range(plan.kamikaze_count)]
    hits, search = minimal_deviations(episodes, {}, runner, lambda *_told: None, request.margin_limit)
    return Margins((tuple(hits),), plan.scenario.eta_max, search)


def _with_equivalent(
    cell: NcapCell, plan: Plan, margins: Margins, phi: Trajectory, request: NcapRequest, runner: Workers
) -> NcapCell:
    """Return a cell with the C of the basic car that has its margin, in the same trials and by the same search."""
    swept = {one: _basic_margins(yardstick(plan, one), phi, request, runner) for one in _MULTIPLIERS}
    found = equivalent_multiplier(margins.per_phi, {one: basic.per_phi for one, basic in swept.items()})
    return replace(cell, equivalent=found.value if math.isfinite(found.value) else None, equivalent_text=found.text)
