"""Sequential stopping: more φ, batch by batch, until the interval of the mean deviation is narrow enough.

Every look has the intervals of `nominal_confidence`, so that they hold with 95 % at whichever one it stops: see
`metrics/sample_size.py`. Each batch has new φ, with as many kamikazes and runs along each; the result is the
assessment of all φ so far, the same as if they had been asked for at once, except for the confidence.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from skd_adversary.safe_trajectories.sources import count_safe_trajectories, load_safe_trajectories
from skd_sim.errors import UsageError
from skd_sim.world.episode import EpisodeLog, EpisodeSpec
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.context import Context, Runner, stage
from skd_evaluator.assessment.options import GENERATED
from skd_evaluator.assessment.plan import EpisodeGroup, Plan
from skd_evaluator.assessment.stages import kamikazes, safe_trajectories
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
        for stage_of_batch in (safe_trajectories.run, kamikazes.run_nominal, kamikazes.run):
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
