"""Sequential stopping: more φ, batch by batch, until the interval of the mean deviation is narrow enough.

Every look has the intervals of `nominal_confidence`, so that they hold with 95 % at whichever one it stops: see
`metrics/sample_size.py`. Each batch has new φ, with as many kamikazes and runs along each; the result is the
assessment of all φ so far, the same as if they had been asked for at once, except for the confidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from skd_adversary.safe_trajectories.sources import count_safe_trajectories, load_safe_trajectories
from skd_sim.errors import UsageError
from skd_sim.options.adversary import Objective
from skd_sim.world.episode import EpisodeLog, Mode
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.assessment import Assessment, assessment_of, in_order
from skd_evaluator.assessment.context import Context, Runner, stage
from skd_evaluator.assessment.objective_result import KamikazeSet
from skd_evaluator.assessment.options import GENERATED
from skd_evaluator.assessment.plan import EpisodeGroup, Plan
from skd_evaluator.assessment.stages import safe_trajectories
from skd_evaluator.assessment.stages.kamikazes import kamikaze_sets
from skd_evaluator.metrics.measures import load_measures
from skd_evaluator.metrics.sample_size import Look, UntilWidth, narrow_enough, nominal_confidence

LOOKS = 10
"""Batches of φ at most."""


@stage(20)  # with --until-width, the next three, batch by batch
def run(context: Context, assessment: Assessment) -> Assessment:
    """Run batches of φ until the interval of the mean deviation is narrow enough, or there are no more looks.

    The plan's number of φ, and of runs along them, is that of one batch. Without a requested width nothing is done.

    Raises:
        UsageError: a batch of one φ, or a source that has not even two batches.
    """
    width, plan = context.until_width, assessment.plan
    if width is None:
        return assessment
    load_measures()
    batch = plan.safe_count
    if batch < 2:
        raise UsageError("--until-width needs two φ in each batch, to see how they differ: give --safe-count 2 or more")
    known, looks = _recorded(plan)
    confidence = nominal_confidence(looks)
    each = -(-plan.collision_runs // batch)
    plans = [replace(plan, objective=objective) for objective in in_order(context.objectives)]
    safe: list[Trajectory] = []
    sets: dict[Objective, list[KamikazeSet]] = {one.objective: [] for one in plans}
    along: list[list[EpisodeLog]] = []
    seen: list[Look] = []
    while True:
        done, count = len(safe), len(safe) + batch
        if known:
            safe = known[:count]
        else:
            more = safe_trajectories.run(context, replace(assessment, plan=replace(plan, safe_count=count)))
            safe = list(more.safe)
        for one in plans:
            sets[one.objective] += kamikaze_sets(one, safe[done:], context.runner, context.progress, first=done)
        along += _runs_along(plans[0], safe, done, each, context.runner)
        context.progress("looks", len(seen) + 1, looks)
        so_far = replace(plan, safe_count=count, collision_runs=each * count)
        nominal_runs = [runs[number] for number in range(each) for runs in along]  # dealt out, as in any assessment
        result = assessment_of(so_far, safe, sets, nominal_runs, confidence)
        found = result.for_deviation.deviation.clustered
        seen.append(Look(count, found))
        if len(seen) == looks or narrow_enough(found, width):
            return replace(
                assessment,
                plan=result.plan,
                safe=result.safe,
                results=result.results,
                nominal_runs=result.nominal_runs,
                confidence=confidence,
                until_width=UntilWidth(width, looks, confidence, tuple(seen)),
            )


def _recorded(plan: Plan) -> tuple[list[Trajectory], int]:
    """Return the φ of a recorded source, in random order, and for how many looks they suffice; None: φ are generated.

    In the order of their files neighbours are alike, so that a batch would have few people.
    """
    if plan.safe in GENERATED:
        return [], LOOKS
    count = count_safe_trajectories(plan.safe, plan.scenario)
    if count < 2 * plan.safe_count:
        raise UsageError(
            f"--until-width adds φ in batches of --safe-count {plan.safe_count}; {plan.safe} has {count}: give fewer"
        )
    every = load_safe_trajectories(plan.safe, plan.scenario, count)
    order = np.random.default_rng(np.random.SeedSequence(plan.seed, spawn_key=(int(EpisodeGroup.SAFE),))).permutation(
        count
    )
    return [every[index] for index in order.tolist()], min(LOOKS, count // plan.safe_count)


def _runs_along(
    plan: Plan, safe: Sequence[Trajectory], first: int, each: int, runner: Runner
) -> list[list[EpisodeLog]]:
    """Run the car against an adversary that follows φ, for those from number `first` on; return the runs of each."""
    episodes = [
        plan.episode(Mode.REPLAY, index, trial, safe[index])
        for index in range(first, len(safe))
        for trial in range(each)
    ]
    logs = list(runner.run(episodes))
    return [logs[start : start + each] for start in range(0, len(logs), each)]
