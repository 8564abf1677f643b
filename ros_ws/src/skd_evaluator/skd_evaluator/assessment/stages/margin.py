"""The margin of an assessment: exact where the car is known, else searched for against the car itself.

The trials are fixed: the first `kamikaze_count` on each φ, whatever became of the kamikazes that were planned in
them. So the margins are a property of the car, and do not depend on what an adversary knew of it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace

import numpy as np
from skd_adversary.adversary import warm_up_episodes
from skd_sim.controllers.controller import with_control_period
from skd_sim.errors import AssessmentError, UsageError
from skd_sim.kernels.compilation import is_kept
from skd_sim.options.car_and_adversary import REFERENCE_DRIVERS, WORLD, AdversaryModel, CarUnderTest, is_own_world
from skd_sim.scenario.scenario import FREE, OCCUPIED, with_oncoming_lane
from skd_sim.simulators.simulator import repeats_itself
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode
from skd_sim.world.state import FloatArray, Trajectory

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.context import Context, Progress, Runner, stage
from skd_evaluator.assessment.files.results import StoredResult
from skd_evaluator.assessment.options import MAXIMUM_ABORTED
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import Workers, available_workers, in_background
from skd_evaluator.margin.actions import has_exact_margin
from skd_evaluator.margin.basic_margins import equivalent_of, kept_margins
from skd_evaluator.margin.common_trajectories import earlier_version, whole_trajectory
from skd_evaluator.margin.exact.exact import exact_margin, search_least
from skd_evaluator.margin.search.rounds import SAME, by_episodes, confirmed, in_processes, one_by_one
from skd_evaluator.margin.search.search import (
    HELD_COMMANDS,
    IN_PROCESS,
    WARM_START,
    WHOLE_EPISODES,
    Effort,
    search_margins,
)
from skd_evaluator.margin.search.trial import prescribed
from skd_evaluator.metrics.aborted import KEEPS_STATE, NOT_CREDIBLE
from skd_evaluator.metrics.deviation import Hit
from skd_evaluator.metrics.frechet import discrete_frechet
from skd_evaluator.metrics.margins import (
    SEARCHED_BY,
    EquivalentMultiplier,
    Margins,
    ReferenceMargin,
    Search,
    difference,
)
from skd_evaluator.version import version

LABEL = "margin"
WHOLE_EPISODE_TRIALS = 5
"""Trials on each φ whose margin is searched by whole episodes."""
HELD_COMMANDS_TRIALS = 1
"""The same where the car does not answer each state, as in real time."""
NEEDS_THE_CAR = "recordings alone do not give it; skd assess does, with the car"
NOT_REQUESTED = "--margin-limit 0: the margin was not requested; leave that option out"


def warm_up_margins() -> None:
    """Compile both searches, or load them from their cache, before they are timed or forked."""
    for episode in warm_up_episodes():
        if episode.mode == Mode.KAMIKAZE:
            exact_margin(episode)
            search_margins([episode], {}, one_by_one, Effort(8, 8))


def why_no_margin(plan: Plan, limit: int, *, whole_episodes: bool) -> str:
    """Return why the margins of a plan cannot be computed, in one line; empty where they can.

    Args:
        plan: the plan of the assessment, which says what the car is.
        limit: how many candidates may be driven in a trial; 0: no margin was requested.
        whole_episodes: whether whole episodes search it.
    """
    if limit == 0:
        return NOT_REQUESTED
    if not repeats_itself(plan.simulator) or not (whole_episodes or is_own_world(plan.simulator)):
        return f"the margin needs SKD's own world: what simulator {plan.simulator} would have done is not known"
    if plan.car.is_external and not whole_episodes:
        return "the margin of a node of its own is searched by whole episodes: skd assess --graph"
    return ""


def exact_or_found(episode: EpisodeSpec) -> Hit | None:
    """Return the hit of least deviation of a known car, or the best one found if the exact search lacks memory."""
    try:
        return exact_margin(episode)
    except UsageError:
        return search_margins([episode], {}, one_by_one).hits[0]


def exact_margins(episodes: Sequence[EpisodeSpec], runner: Workers, progress: Progress) -> list[Hit | None]:
    """Return the hit of least deviation in each of some episodes of a known car; None where there is none."""
    found = []
    for count, hit in enumerate(runner.map(exact_or_found, episodes), start=1):
        found.append(hit)
        progress(LABEL, count, len(episodes))
    return found


def minimal_deviations(
    episodes: Sequence[EpisodeSpec],
    logs: Mapping[int, Sequence[EpisodeLog]],
    runner: Workers,
    progress: Progress,
    limit: int,
    earlier: StoredResult | None = None,
) -> tuple[list[Hit | None], Search | None]:
    """Return the hits of least deviation of a car that runs in process, and how they were searched for; None: exact.

    Args:
        episodes: the trials: kamikaze mode, of one car, at least one.
        logs: what happened to kamikazes in them, by the id of their episode.
        runner: computes them, in several processes.
        progress: called with how far the work is.
        limit: candidates that may be driven in a trial.
        earlier: result of another version of the car, with whose hits the search begins.

    Raises:
        UsageError: it is not of these trials.
        AssessmentError: the car fails, or answers differently to the same trajectories.
    """
    first = episodes[0]
    if has_exact_margin(first.car, first.scenario):
        return exact_margins(episodes, runner, progress), None
    before = None if earlier is None else earlier_version(earlier, episodes, runner)
    effort = _effort(IN_PROCESS if before is None else WARM_START, limit)
    found = search_margins(episodes, logs, in_processes(runner, progress), effort, before)
    hits, again = (sum(one is not None for one in some) for some in (found.hits, confirmed(episodes, found, runner)))
    if again < hits:
        car, found_again = first.car.short_controller, f"of {hits} hits {again} came again"
        raise AssessmentError(f"controller {car} {KEEPS_STATE}; draw from `rng`: {found_again}")
    return found.hits, replace(found.search, how="" if earlier is None else f"from the hits of {earlier.folder} on")


def _effort(usual: Effort, limit: int) -> Effort:
    """Return an effort with another limit, in candidates of a car in process."""
    most = max(1, limit * usual.limit // IN_PROCESS.limit)
    return usual._replace(first=min(usual.first, most), limit=most)


def _without_noise(episode: EpisodeSpec) -> EpisodeSpec:
    """Return a trial in another simulator, whose car has nothing of the noise that SKD's own world draws."""
    car = replace(episode.scenario.car, speed_noise=0.0, acceleration_noise=0.0)
    return replace(episode, scenario=replace(episode.scenario, car=car), public=episode.public_scenario)


def _by_whole_episodes(
    episodes: Sequence[EpisodeSpec],
    logs: Mapping[int, Sequence[EpisodeLog]],
    plan: Plan,
    runner: Runner,
    context: Context,
) -> tuple[list[Hit | None], Search, list[str]]:
    """Return the hits that whole episodes have found, how they were searched for, and warnings, a line each.

    Raises:
        AssessmentError: the car fails, or more episodes were aborted than may be.
    """
    held, earlier = context.holds_commands, context.earlier
    effort = _effort(HELD_COMMANDS if held else WHOLE_EPISODES, context.margin_limit)
    before = None if earlier is None else earlier_version(earlier, episodes, runner)
    effort = effort if before is None else effort._replace(first=min(WARM_START.first, effort.limit))
    found = search_margins(episodes, logs, by_episodes(runner, context.progress), effort, before)
    warnings = []
    best = confirmed(episodes, found, runner, math.inf if held else SAME)
    hits, again = (sum(one is not None for one in some) for some in (found.hits, best))
    if found.reasons:
        lost = f"{len(found.reasons)} episodes of the search for the margin were aborted ({found.reasons[0]})"
        if len(found.reasons) > MAXIMUM_ABORTED * found.driven:
            raise AssessmentError(lost)
        warnings.append(f"{lost}: the margin may be less")
    if again < hits and not is_own_world(plan.simulator):
        which = f"simulator {plan.simulator}, or controller {plan.car.short_controller},"
        warnings.append(f"{NOT_CREDIBLE}{which} does not repeat itself: of {hits} hits {again} came again")
    came = f"{again} of {hits} hits came again" if hits else "none hit"
    if held and again < hits:
        came += f", the others count as {plan.scenario.eta_max:g} m"
    begun = "" if earlier is None else f", from the hits of {earlier.folder} on"
    how = f"by up to {found.search.budget} {tuple(SEARCHED_BY)[held]} a trial{begun}; {came}"
    return (
        (best if held else found.hits),
        replace(found.search, how=how, converged=found.search.converged and not held),
        warnings,
    )


def _margins(
    plan: Plan, assessment: Assessment, logs: Mapping[int, Sequence[EpisodeLog]], context: Context, *, whole: bool
) -> tuple[Margins, list[str]]:
    """Return the margins of the trials of a plan, and warnings, a line each; `whole`: whole episodes search them."""
    most = HELD_COMMANDS_TRIALS if context.holds_commands else WHOLE_EPISODE_TRIALS
    each = min(plan.kamikaze_count, most) if whole else plan.kamikaze_count
    episodes = plan.trials(assessment.safe, each)
    search: Search | None
    warnings: list[str] = []
    if whole:
        trials = episodes if is_own_world(plan.simulator) else [_without_noise(one) for one in episodes]
        found, search, warnings = _by_whole_episodes(trials, logs, plan, _runner(plan, context), context)
    else:
        found, search = minimal_deviations(
            episodes, logs, context.workers, context.progress, context.margin_limit, context.earlier
        )
    hits = tuple(tuple(found[start : start + each]) for start in range(0, len(found), each))
    return Margins(hits, plan.scenario.eta_max, search, assessment.confidence), warnings


def _runner(plan: Plan, context: Context) -> Runner:
    return context.runner if plan.car.is_external else context.workers


def _lower_of_both_lanes(
    plan: Plan, assessment: Assessment, margins: Margins, warnings: list[str], context: Context, *, whole: bool
) -> tuple[Margins, list[str]]:
    """Return the lower of the margins with the oncoming lane as it is and in its other state; there the hits are tried.

    Args:
        plan: the plan of the assessment.
        assessment: what is known.
        margins: with the lane as the scenario has it.
        warnings: of these.
        context: who searches.
        whole: whether whole episodes search.
    """
    own = plan.scenario.oncoming_lane
    state = FREE if own == OCCUPIED else OCCUPIED
    try:
        other = replace(plan, scenario=with_oncoming_lane(plan.scenario, state))
    except UsageError as error:
        return margins, [*warnings, f"the margin with the oncoming lane {state} is not known: {error}"]
    trials = other.trials(assessment.safe, len(margins.hits[0]))
    pairs = zip(trials, itertools.chain.from_iterable(margins.hits), strict=True)
    known = [prescribed(trial, whole_trajectory(hit)) for trial, hit in pairs if hit is not None]
    logs = {log.episode.episode_id: [log] for log in _runner(plan, context).run(known)}
    further, lines = _margins(other, assessment, logs, context, whole=whole)
    both = sorted([(margins.mean, own, margins), (further.mean, state, further)], key=lambda one: one[0])
    lanes = {lane: mean for mean, lane, _ in both}
    return replace(both[0][2], lanes=lanes), [*warnings, *lines]


@stage(70)
def run(context: Context, assessment: Assessment) -> Assessment:
    """Return the assessment with the margin of the car, and the C of the basic car with the same; or why there is none.

    A car that is a node of its own, or in another simulator than SKD's own world, is searched by whole episodes.
    """
    plan, held = assessment.for_deviation.plan, context.holds_commands
    whole = (context.repeats or held) and (plan.car.is_external or not is_own_world(plan.simulator))
    note = why_no_margin(plan, context.margin_limit, whole_episodes=whole)
    if not note and whole and 2 * len(assessment.reasons) > assessment.episodes:
        note = "most episodes were aborted, and so would be those that search it"
    if note:
        return replace(assessment, margin_note=note)
    logs: dict[int, list[EpisodeLog]] = {}
    for log in assessment.kamikaze_logs:
        logs.setdefault(log.episode.episode_id, []).append(log)
    try:
        margins, warnings = _margins(plan, assessment, logs, context, whole=whole)
        if assessment.lanes_left and plan.scenario.oncoming_lane:
            margins, warnings = _lower_of_both_lanes(plan, assessment, margins, warnings, context, whole=whole)
    except AssessmentError as error:
        return assessment.failed(error, margin_note="its search ended")
    equivalent: EquivalentMultiplier | None
    if margins.exact:  # it is a basic car itself
        own = plan.multiplier
        equivalent, note = EquivalentMultiplier(own, (own, own), (own, own), own, own), ""
    else:
        equivalent, note = equivalent_of(plan, assessment.safe, margins.per_phi, context.workers, context.progress)
    return replace(
        assessment,
        margins=margins,
        equivalent=equivalent,
        equivalent_note=note,
        warnings=(*assessment.warnings, *warnings),
    )


@contextmanager
def margins_compiled_in_background(*, needed: bool = True) -> Iterator[Callable[[], None]]:
    """Begin to compile the searches for the margin in another process, where that is to be done anew.

    They take as long as the planners of an assessment, nearly half a minute, and most machines have a second core. What
    is compiled there comes by the cache on disk, as in any later run, so nothing of a result depends on it.

    Yields what loads them into this process, for `Workers.start`: it waits for the other process first. Enter it
    before other threads start: a process with threads is not safe to fork.

    Args:
        needed: whether any margin is to be computed; if not, nothing is done.
    """

    def compile_anew() -> None:
        warm_up_margins()
        discrete_frechet(np.zeros((2, 2)), np.ones((2, 2)))

    with ExitStack() as stack:
        wait: Callable[[], bool] | None = None
        if needed and available_workers() > 1 and not is_kept(search_least):
            wait = stack.enter_context(in_background(compile_anew))

        def load() -> None:
            if wait is not None:
                wait()  # however it ended: what it has not compiled is compiled here
            if needed:
                warm_up_margins()

        yield load


MOST_TRIALS = 60
"""In which the drivers are compared."""


@stage(75)
def run_reference(context: Context, assessment: Assessment) -> Assessment:
    """Return the assessment with the margins of all reference drivers in the car's first trials, where requested.

    They are searched for as those of any car: some ten seconds for each driver. They are kept in the user's cache,
    beside those of basic cars, under the hash of all that they depend on, so that the next car in these trials has them
    at once.
    """
    margins = assessment.margins
    if not context.reference or margins is None:
        return assessment
    each = min(len(margins.per_phi[0]), math.ceil(MOST_TRIALS / len(assessment.safe)))
    own = [np.minimum(one[:each], margins.eta_max) for one in margins.per_phi]
    found, warnings = [], list(assessment.warnings)
    for name in REFERENCE_DRIVERS:
        try:
            theirs, converged = _reference_margins(_plan_of(assessment.plan, name), assessment.safe, each, context)
        except (AssessmentError, UsageError) as error:
            warnings.append(f"not compared with reference driver {name}: {error}")
            continue
        compared = difference(own, theirs)
        if compared is None or compared.ci95 is None:
            warnings.append("not compared with reference drivers: that needs two safe trajectories")
            break
        bounds = not margins.converged, not converged
        found.append(
            ReferenceMargin(name, float(np.mean(theirs)), compared.mean, compared.ci95, compared.trials, bounds)
        )
    return replace(assessment, reference=tuple(found), warnings=tuple(warnings))


def _plan_of(plan: Plan, name: str) -> Plan:
    """Return the plan with a reference driver in the place of the car, in SKD's own world."""
    period = CarUnderTest(name).kind.control_period
    scenario = with_control_period(replace(plan.scenario, control_period=None), period, name)
    known = AdversaryModel.GENERIC  # nothing is planned
    return replace(plan, scenario=scenario, controller=name, adversary_model=known, car_model="", simulator=WORLD)


def _reference_margins(
    plan: Plan, safe: Sequence[Trajectory], each: int, context: Context
) -> tuple[list[FloatArray], bool]:
    """Return a driver's margins in the first trials of each φ (m), and whether the search for them has converged."""

    def progress(label: str, done: int, total: int) -> None:
        context.progress(f"{label}, {plan.controller}", done, total)

    def compute() -> tuple[FloatArray, bool]:
        hits, search = minimal_deviations(plan.trials(safe, each), {}, context.workers, progress, context.margin_limit)
        found = Margins((tuple(hits),), plan.scenario.eta_max, search)
        return found.values, found.converged

    return kept_margins(plan, safe, each, [plan.controller, context.margin_limit, version()], compute)
