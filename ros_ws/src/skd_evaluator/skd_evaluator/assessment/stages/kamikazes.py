"""Kamikazes, and runs along φ: the episodes from which SKD, the deviation and the contact rate follow.

Points of the vulnerability curve are kamikazes that may not deviate further than given: their bound.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from skd_adversary.safe_trajectories.sources import count_safe_trajectories, load_safe_trajectories
from skd_sim.errors import UsageError
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.assessment import Assessment, KamikazeSet, ObjectiveResult, in_order, objective_results
from skd_evaluator.assessment.context import Context, Progress, Runner, run_episodes, silent, stage
from skd_evaluator.assessment.episode_figures import steers
from skd_evaluator.assessment.options import GENERATED
from skd_evaluator.assessment.plan import TRIALS_PER_REQUESTED, EpisodeGroup, Plan, runs_along
from skd_evaluator.assessment.stages import safe_trajectories
from skd_evaluator.metrics.deviation import deviation
from skd_evaluator.metrics.measures import load_measures
from skd_evaluator.metrics.sample_size import Look, UntilWidth, narrow_enough, nominal_confidence
from skd_evaluator.metrics.vulnerability_curve import BudgetPoint, budget_points

BOUNDS = (0.25, 0.5, 1.0, 2.0)
"""η, m, to which kamikazes are bounded."""
_PART = 4
"""One in so many of an assessment's trials is made for each bound."""


@stage(40)
def run(context: Context, assessment: Assessment) -> Assessment:
    """Return the assessment with what the kamikazes of each objective reached, unless that is known already."""
    if assessment.results:
        return assessment
    load_measures()  # one that cannot be loaded is said before anything is run
    plans = [replace(assessment.plan, objective=objective) for objective in in_order(context.objectives)]
    sets = {one.objective: kamikaze_sets(one, assessment.safe, context.runner, context.progress) for one in plans}
    results = objective_results(assessment.plan, sets, assessment.confidence)
    return replace(assessment, plan=results[0].plan, results=results)


@stage(35)  # first: whether the car steers matters to kamikazes
def run_nominal(context: Context, assessment: Assessment) -> Assessment:
    """Return the assessment with the runs of the car against an adversary that follows φ, unless they are known."""
    if assessment.nominal_runs:
        return assessment
    plan = replace(assessment.plan, objective=in_order(context.objectives)[0])
    episodes = runs_along(plan, assessment.safe)
    logs = tuple(run_episodes(context.runner, episodes, "nominal runs", context.progress))
    return replace(assessment, nominal_runs=logs, plan=with_steering(assessment.plan, logs))


def with_steering(plan: Plan, logs: Sequence[EpisodeLog]) -> Plan:
    """Return a plan that says whether the car steers, by runs of it."""
    return replace(plan, steers=plan.steers or any(map(steers, logs)))


@stage(100)
def run_bounded(context: Context, assessment: Assessment) -> Assessment:
    """Return the assessment with points of the vulnerability curve, where it is requested.

    Only kamikazes of objective `deviation` can be bounded.
    """
    result = assessment.for_deviation
    if not context.curve or not result.plan.limits_deviation or not result.trials:
        return assessment
    points: list[BudgetPoint] = []
    for number, eta in enumerate(BOUNDS, start=1):
        points.append(bounded_point(result, assessment.safe, eta, context.runner))
        context.progress("bounded kamikazes", number, len(BOUNDS))
    return replace(assessment, budgets=tuple(budget_points(points)))


def kamikaze_sets(
    plan: Plan, safe: Sequence[Trajectory], runner: Runner, progress: Progress = silent
) -> list[KamikazeSet]:
    """Return Ψ(φ) for each φ: episodes are drawn until enough have collided, or a cap is reached.

    Args:
        plan: the campaign.
        safe: Φ.
        runner: runs the episodes.
        progress: called with how far the work is.
    """
    tried: list[list[EpisodeLog]] = [[] for _ in safe]
    found = [0] * len(safe)
    cap = TRIALS_PER_REQUESTED * plan.kamikaze_count
    total = plan.kamikaze_count * len(safe)
    label = f"kamikazes ({plan.objective})"
    while True:
        batch: list[tuple[int, EpisodeSpec]] = []
        for index, trajectory in enumerate(safe):
            trials = len(tried[index])
            missing = min(plan.kamikaze_count - found[index], cap - trials)
            for trial in range(trials, trials + missing):
                batch.append((index, plan.episode(Mode.KAMIKAZE, index, trial, trajectory)))
        if not batch:
            break
        logs = run_episodes(runner, [spec for _, spec in batch], label, progress, sum(found), total)
        for (index, _), log in zip(batch, logs, strict=True):
            tried[index].append(log)
            found[index] += plan.succeeds(log)
    return [KamikazeSet(trajectory, tuple(logs)) for trajectory, logs in zip(safe, tried, strict=True)]


def bounded_trials(plan: Plan) -> int:
    """Return how many kamikazes are bounded by each η, for each φ."""
    return max(1, -(-plan.kamikaze_count // _PART))


def bounded_point(result: ObjectiveResult, safe: Sequence[Trajectory], eta: float, runner: Runner) -> BudgetPoint:
    """Run kamikazes that plan for a deviation of at most η; return how many were hit within it, and of how many.

    Their number is fixed beforehand: to go on until enough have collided would make the share too high.
    """
    plan = replace(result.plan, maximum_distance=eta)
    episodes = plan.trials(safe, bounded_trials(plan))
    successes = aborted = 0
    for log in runner.run(episodes):
        aborted += log.outcome == Outcome.ABORTED
        if log.hit:
            phi = log.episode.safe_trajectory
            assert phi is not None
            ticks = log.impact_time / plan.scenario.time_step
            successes += deviation(phi.positions, log.trajectory.positions, ticks) <= eta
    return BudgetPoint(eta, successes, len(episodes) - aborted, aborted)


LOOKS = 10
"""Batches of φ at most."""


@stage(20)  # with --until-width, the next three, batch by batch
def run_until_width(context: Context, assessment: Assessment) -> Assessment:
    """Run batches of φ until the interval of the mean deviation is narrow enough, or there are no more looks.

    The plan's number of φ, and of runs along them, is that of one batch. Each has new φ, with as many kamikazes and
    runs along each; the result is the assessment of all φ so far, the same as if they had been asked for at once,
    except for the confidence. Every look has the intervals of `nominal_confidence`, so that they hold with 95 % at
    whichever one it stops: see `metrics/sample_size.py`. Without a requested width nothing is done.

    Raises:
        UsageError: a batch of one φ, or a source that has not even two batches.
    """
    width, plan = context.until_width, assessment.plan
    if width is None:
        return assessment
    batch = plan.safe_count
    if batch < 2:
        raise UsageError("--until-width needs two φ in each batch, to see how they differ: give --safe-count 2 or more")
    known, looks = _recorded(plan)
    confidence, each = nominal_confidence(looks), -(-plan.collision_runs // batch)
    here = replace(context, runner=_Remembering(context.runner))
    seen: list[Look] = []
    while True:
        count = batch * (len(seen) + 1)
        so_far = replace(plan, safe_count=count, collision_runs=each * count)
        result = replace(assessment, plan=so_far, safe=tuple(known[:count]), confidence=confidence)
        for stage_of_batch in (safe_trajectories.run, run_nominal, run):
            result = stage_of_batch(here, result)
        found = result.for_deviation.deviation.clustered
        seen.append(Look(count, found))
        context.progress("looks", len(seen), looks)
        if len(seen) == looks or narrow_enough(found, width):
            return replace(result, until_width=UntilWidth(width, looks, confidence, tuple(seen)))


class _Remembering:
    """Runs each episode once."""

    def __init__(self, runner: Runner) -> None:
        self._runner = runner
        self._known: dict[tuple[object, ...], EpisodeLog] = {}

    def run(self, episodes: Sequence[EpisodeSpec]) -> Iterator[EpisodeLog]:
        keys = [(one.mode, one.objective, one.episode_id) for one in episodes]
        pairs = zip(keys, episodes, strict=True)
        fresh = self._runner.run([one for key, one in pairs if key not in self._known])
        for key in keys:
            if key not in self._known:
                self._known[key] = next(fresh)
            yield self._known[key]


def _recorded(plan: Plan) -> tuple[list[Trajectory], int]:
    """Return the φ of a recorded source, in random order, and for how many looks they suffice; None: φ are generated.

    In the order of their files neighbours are alike, so that a batch would have few people.
    """
    if plan.safe in GENERATED:
        return [], LOOKS
    count = count_safe_trajectories(plan.safe, plan.scenario)
    if count < 2 * plan.safe_count:
        raise UsageError(f"--until-width adds batches of {plan.safe_count} φ; {plan.safe} has {count}: give fewer")
    every = load_safe_trajectories(plan.safe, plan.scenario, count)
    order = np.random.default_rng(np.random.SeedSequence(plan.seed, spawn_key=(int(EpisodeGroup.SAFE),))).permutation(
        count
    )
    return [every[index] for index in order.tolist()], min(LOOKS, count // plan.safe_count)
