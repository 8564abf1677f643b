"""Whether a user's car repeats itself and drives, without which its figures say nothing.

A sample of the episodes is run again in another order, in a process (or a node graph) that has run nothing before. In
SKD's own world and in lockstep an episode follows from its specification and the car alone, so it must give the same
log. It does not if the car keeps something from one episode to the next, or draws from a generator of its own: then
figures depend on the order of the episodes and on the number of workers.

A car that does not drive hits no road user, and is none the safer for it. So a few drives have none near. What another
simulator says of the car is kept, and warned of.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from skd_sim.controllers.controller import with_control_period
from skd_sim.controllers.isolated import CALL_LIMIT
from skd_sim.errors import AssessmentError, UsageError
from skd_sim.options.car_and_adversary import EXTERNAL, is_own_world
from skd_sim.scenario.road import beside_road
from skd_sim.scenario.scenario import Scenario
from skd_sim.simulators.simulator import make_simulator
from skd_sim.world.episode import AbortKind, EpisodeLog, EpisodeSpec, Mode, Outcome, kind_of
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment import episode_figures
from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.context import Context, Fresh, Runner, stage
from skd_evaluator.assessment.plan import EpisodeGroup, Plan, episode_id, split_episode_id
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.metrics.aborted import KEEPS_STATE, NOT_CREDIBLE, UNDISTURBED, aborted_lines

SAMPLE: Final = 24
"""Episodes that are run again, at most."""
FEW_HITS: Final = 0.05
"""Share of the sample that may hit in one of the two runs alone before the figures are not credible."""
DRIVES: Final = 5
"""Undisturbed drives."""
_ALIKE = 1e-6  # m, m/s, s: what libraries that add up in several threads may differ by
_KEEPS = 0.5  # share of its speed that a car keeps on a free road, whatever its noise
_FAR = 1000.0  # m up the road, and as many beside it
_SECONDS = 6.0  # in which a car of 60 km/h stops at 3 m/s²
_LAST = 0xFFFF_FFFF  # number of no crossing; no drive is recorded


@stage(110)
def run(context: Context, assessment: Assessment) -> Assessment:
    """Return the assessment with warnings: episodes that were aborted, and a user's car that hardly drives."""
    plan = assessment.plan
    if _gave_up(assessment):
        return assessment
    lines = [*aborted_lines(assessment.as_dict()), *episode_figures.missed_periods(plan.car.label, assessment.logs)]
    if not plan.car.is_own:
        lines += episode_figures.standing(plan.car.label, assessment.nominal_runs)
        if is_own_world(plan.simulator) and len(assessment.reasons) < assessment.episodes:
            lines += driving(plan, context.runner)
    return replace(assessment, warnings=(*assessment.warnings, *lines))


@stage(120)
def run_again(context: Context, assessment: Assessment) -> Assessment:
    """Return the assessment with a warning if a user's car does not repeat itself in a sample of its episodes."""
    if assessment.plan.car.is_own or context.fresh is None or _gave_up(assessment):
        return assessment
    found = repeatability(assessment.plan.car.label, assessment.logs, context.fresh)
    return replace(assessment, warnings=(*assessment.warnings, *found))


def _gave_up(assessment: Assessment) -> bool:
    """Whether the car's process ended again and again, or did not repeat itself, in a stage before, which says it."""
    kinds = [kind_of(line.removeprefix(NOT_CREDIBLE)) for line in assessment.warnings]
    return AbortKind.ENDED in kinds or any(KEEPS_STATE in line for line in assessment.warnings)


@contextmanager
def fresh_process(answer_limit: float = CALL_LIMIT) -> Iterator[Runner]:
    """Run episodes in a new process, into which no controller has been loaded.

    Args:
        answer_limit: time that a call of a user's controller may take, s.
    """
    with InProcessRunner(1, isolated=True, answer_limit=answer_limit) as runner:
        runner.start()
        yield runner


# --- the same again


def sample_of(logs: Sequence[EpisodeLog]) -> list[EpisodeLog]:
    """Return some episodes, evenly spread over all that can be repeated.

    Aborted episodes cannot, nor can those of other simulators, nor those in real time.
    """
    able = [
        log
        for log in logs
        if log.outcome != Outcome.ABORTED and is_own_world(log.episode.simulator) and log.timing.delay == 0.0
    ]
    return [able[number * len(able) // SAMPLE] for number in range(SAMPLE)] if len(able) > SAMPLE else able


def is_same(first: EpisodeLog, second: EpisodeLog) -> bool:
    """Tell whether two logs of an episode say the same."""
    if first.outcome != second.outcome or first.car.shape != second.car.shape:
        return False
    pairs = (
        (first.adversary, second.adversary),
        (first.car, second.car),
        (first.impact_time, second.impact_time),
        (first.impact_speed, second.impact_speed),
    )
    return all(np.allclose(one, other, rtol=0.0, atol=_ALIKE, equal_nan=True) for one, other in pairs)


def repeatability(car: str, logs: Sequence[EpisodeLog], fresh: Fresh) -> tuple[str, ...]:
    """Run a sample of a user's car's episodes again, and return in a line what did not repeat itself; empty: all did.

    The line begins with `NOT_CREDIBLE` where the headline depends on it: hits come or go with the order of the
    episodes, or the car fails.

    Args:
        car: name of the car.
        logs: its episodes, in the order in which they were run.
        fresh: makes the runner of the second run.
    """
    some = sample_of(logs)
    if not some:
        return ()
    # An order without a rule: reversed, every second episode may again be the second.
    first = [some[number] for number in np.random.default_rng(len(some)).permutation(len(some))]
    try:
        with fresh() as runner:
            second = list(runner.run([log.episode for log in first]))
    except (AssessmentError, UsageError, OSError) as error:  # OSError: what starts it is gone
        return (f"{NOT_CREDIBLE}{car} failed when {len(first)} episodes were run again: {error}",)
    found = []
    if lost := [log.reason for log in second if log.outcome == Outcome.ABORTED]:
        begin = NOT_CREDIBLE if len(lost) > FEW_HITS * len(first) else ""
        found.append(f"{begin}{len(lost)} of {len(first)} episodes were aborted when they were run again: {lost[0]}")
    pairs = [(one, other) for one, other in zip(first, second, strict=True) if other.outcome != Outcome.ABORTED]
    if changed := [pair for pair in pairs if not is_same(*pair)]:
        hits = sum(one.hit != other.hit for one, other in changed)
        begin, log = NOT_CREDIBLE if hits > FEW_HITS * len(first) else "", changed[0][0]
        _, phi, trial = split_episode_id(log.episode.episode_id)
        where = f"first: {log.episode.mode.name.lower()}, φ {phi}, trial {trial}"
        ended = f"ended differently in another order, {hits} of them in a hit in one order alone ({where})"
        why = f"{car} {KEEPS_STATE}"
        why += ": give -p reset:=restart, or forget at /skd/episode" if log.episode.controller == EXTERNAL else ""
        if held := sum(one.timing.held or other.timing.held for one, other in changed):
            why += f"; or raise -p quiet_time: in {held} control periods no command came in time"
        found.append(f"{begin}{len(changed)} of {len(first)} episodes {ended}. {why}")
    return tuple(found)


# --- whether it drives


class Drive(NamedTuple):
    """How a car drove with no road user near.

    Attributes:
        first: speed at the beginning, m/s.
        last: speed at the end, m/s.
        leaves: whether the car left the road.
    """

    first: float
    last: float
    leaves: bool

    @property
    def slows(self) -> bool:
        """Whether the car slowed down by much."""
        return self.last < _KEEPS * self.first


def undisturbed_drives(plan: Plan, runner: Runner) -> list[Drive]:
    """Return how a car drives that has the road for itself, the slowest first.

    The adversary is far behind it, or, where the car slows down for that, far ahead: it is no matter for which it does.

    Raises:
        AssessmentError: the car fails.
    """
    behind = _drives(plan, runner, -_FAR)
    if not any(drive.slows for drive in behind):
        return behind
    return max(behind, _drives(plan, runner, _FAR), key=lambda drives: [drive.last for drive in drives])


def _drives(plan: Plan, runner: Runner, along: float) -> list[Drive]:
    found = []
    for log in runner.run([_undisturbed(plan, number, along) for number in range(DRIVES)]):
        if log.outcome == Outcome.ABORTED:
            raise AssessmentError(log.reason)
        first, last = log.car[[0, -1], 3].tolist()
        found.append(Drive(first, last, episode_figures.collision_partner(log) == episode_figures.ROAD_EDGE))
    return sorted(found, key=lambda drive: drive.last)


def driving(plan: Plan, runner: Runner) -> tuple[str, ...]:
    """Return, a line each, that a car leaves the road or slows down with no road user near; empty if it drives.

    A line begins with `NOT_CREDIBLE` where most of the drives leave the road or end slower than a hit begins, or where
    the car fails.
    """
    try:
        drives = undisturbed_drives(plan, runner)
    except AssessmentError as error:
        return (f"{NOT_CREDIBLE}{UNDISTURBED}{plan.car.label} failed: {error}",)
    found, of_how_many = [], f"of {len(drives)} drives of {_SECONDS:g} s"
    if left := sum(drive.leaves for drive in drives):
        begin = NOT_CREDIBLE if 2 * left > len(drives) else ""
        found.append(f"{begin}{UNDISTURBED}{plan.car.label} leaves the road in {left} {of_how_many}; angles are in rad")
    if slow := [drive for drive in drives if drive.slows]:
        first, last, _ = slow[len(slow) // 2]
        line = f"{UNDISTURBED}{plan.car.label} slows from {first:.1f} to {last:.1f} m/s in {len(slow)} {of_how_many}"
        least = plan.scenario.collision.hit_speed
        stands = f"{NOT_CREDIBLE}{line}, and a hit begins at {least:g} m/s: {episode_figures.DRIVES_NOT}"
        still = statistics.median(drive.last for drive in drives) < least
        found.append(stands if still else f"{line}: its margin and risk are better for that, too")
    return tuple(found)


def _undisturbed(plan: Plan, number: int, along: float) -> EpisodeSpec:
    """Return an episode without road users: the adversary stands far beside the road, at a path coordinate (m)."""
    clocked = with_control_period(plan.scenario, plan.car.kind.control_period, plan.controller)
    public = replace(clocked, others=())
    scenario = replace(public, car=replace(public.car, meet_safe_trajectory=False))
    ticks = min(scenario.ticks, round(_SECONDS / scenario.time_step))
    away = np.tile([-_FAR * scenario.end.crossing, along], (ticks + 1, 1))
    nowhere = Trajectory(beside_road(scenario.road.line, away), scenario.time_step, "undisturbed")
    return EpisodeSpec(
        scenario,
        Mode.REPLAY,
        plan.seed,
        episode_id(EpisodeGroup.RISK, 0xFFFF, _LAST - number),
        nowhere,
        public=public,
        controller=plan.controller,
        multiplier=plan.multiplier,
    )


_STRAYED: Final = 0.01
"""m: far more than another simulator rounds, and less than any figure shows."""


def described(simulator_and_scenario: tuple[str, Scenario]) -> Mapping[str, Any] | None:
    """Return, as plain data, what a simulator says of a scenario's car; None where it says nothing.

    A simulator says it by a method `described(scenario)`.
    """
    name, scenario = simulator_and_scenario
    describe = getattr(make_simulator(name), "described", None)
    return dict(describe(scenario)) if callable(describe) else None


@stage(60)
def simulation(context: Context, assessment: Assessment) -> Assessment:
    """Return the assessment with what its simulator says of the car, asked in a process that may run it.

    So it is warned of episodes that cannot have happened, and of an adversary that does not go quite as it is told.
    """
    plan = assessment.plan
    if is_own_world(plan.simulator):
        return assessment
    said = next(iter(context.workers.map(described, [(plan.simulator, plan.scenario)])))
    lines = (*assessment.warnings, *_warnings(assessment, plan.simulator))
    return replace(assessment, simulation=said, warnings=lines)


def _warnings(assessment: Assessment, simulator: str) -> tuple[str, ...]:
    """Return what a reader should know of what a simulator said in the episodes of an assessment, a line each."""
    found = []
    refuted = [one for one in assessment.reasons if kind_of(one) in (AbortKind.REFUTED, AbortKind.NOT_FINITE)]
    if refuted:
        count = f"{len(refuted)} of {assessment.episodes} episodes in simulator {simulator}"
        found.append(f"{count} cannot have happened, and count for nothing ({refuted[0]})")
    logs = assessment.logs
    strayed = [log.strayed for log in logs if log.strayed > _STRAYED]
    if strayed:
        count = f"in {len(strayed)} of {len(logs)} episodes in simulator {simulator}"
        found.append(f"{count} the adversary was up to {max(strayed):.2g} m from where it was commanded to go")
    return tuple(found)
