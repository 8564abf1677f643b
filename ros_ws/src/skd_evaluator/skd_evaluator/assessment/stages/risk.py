"""The risk of an assessment: how likely the front of the moving car hits people who cross as people do.

Of a car that is known compiled crossings are run, of any other whole episodes; subset simulation where they show few
hits. Nothing in it depends on time or on who computes it: crude crossings draw by their numbers, replicates by theirs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np
from skd_adversary.crossing.road_users import road_user_named
from skd_sim.errors import AssessmentError, UsageError
from skd_sim.options.car_and_adversary import is_own_world
from skd_sim.simulators.simulator import repeats_itself
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Role, generator
from skd_sim.world.state import FloatArray

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.context import Context, Progress, RiskRequest, Runner, stage
from skd_evaluator.assessment.failures import Failures, Walkers, failures_of
from skd_evaluator.assessment.files.result_folder import check_unchanged
from skd_evaluator.assessment.options import NO_BEHAVIOUR
from skd_evaluator.assessment.plan import EpisodeGroup, Plan, episode_id
from skd_evaluator.assessment.run.workers import InProcessRunner, Workers
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.margin.actions import has_exact_margin
from skd_evaluator.metrics.behaviour.model import Behaviour, file_of, load_behaviour
from skd_evaluator.metrics.risks import FEW_HITS, SCALES, Risks, ScaleRisk, Subsets, Touch
from skd_evaluator.risk.crossings import (
    AnyCar,
    CrossingModel,
    CrossingPlan,
    Crossings,
    Ends,
    KnownCar,
    batched_car,
    end_of,
)
from skd_evaluator.risk.subset import AbortedCrossingsError, Replicate, SubsetEffort, gathered, levels_of, replicate

LABEL: Final = "risk"
RUNS: Final = 2000
"""Crude crossings at each scale, of a car that is known."""
OTHER_RUNS: Final = 500
"""And of any other car."""
GRAPH_RUNS: Final = 100
"""And through the node graph."""
_AT_A_TIME = 100  # crossings of which the progress is told


def why_no_risk(plan: Plan, behaviour: Behaviour | None) -> str:
    """Return why there is no risk of a plan, in one line; empty where there is one."""
    scenario = plan.scenario
    if behaviour is None:
        return NOT_REQUESTED
    if not repeats_itself(plan.simulator):
        return f"the risk needs SKD's own world: crossings in simulator {plan.simulator} are not run"
    kind = road_user_named(scenario.adversary.kind).name
    if kind != behaviour.kind:
        return f"behaviour {behaviour.name} is of a {behaviour.kind}, and the adversary is a {kind}: give --behaviour"
    if scenario.adversary.is_box:
        return "the side of a contact is known of an adversary that is a disc alone"
    return ""


def _has_exact_margin(plan: Plan) -> bool:
    """Return whether kernels say what a plan's car does: one that is known, in SKD's own world."""
    return is_own_world(plan.simulator) and has_exact_margin(plan.car, plan.scenario)


def runs_of(plan: Plan, request: RiskRequest, *, graph: bool = False) -> int:
    """Return how many crude crossings there are at each scale: at most four for each run along φ, by default."""
    if request.runs is not None:
        return request.runs
    most = GRAPH_RUNS if graph else RUNS if _has_exact_margin(plan) else OTHER_RUNS
    return min(most, plan.collision_runs if graph else 4 * plan.collision_runs)


def walkers_of(crossing_plan: CrossingPlan) -> Walkers:
    """Return who walks the crude crossings."""
    plan = crossing_plan.plan
    return Walkers(plan.scenario, [phi.positions for phi in crossing_plan.safe], plan.seed, crossing_plan.values)


def crude_crossings(crossing_plan: CrossingPlan, runs: int) -> Crossings:
    """Return the crude crossings, the same for every car and at every scale; φ take turns."""
    phis = len(crossing_plan.safe)
    phi, draw = np.arange(runs) % phis, np.arange(runs) // phis
    walkers = walkers_of(crossing_plan)
    walker = np.empty((runs, crossing_plan.walker_normals))
    for row in range(runs):
        walker[row] = walkers.normals(row)
    return Crossings(phi, walker, np.empty((runs, 0)), draw)


def draws_of(crossing_plan: CrossingPlan, crossings: Crossings) -> FloatArray:
    """Return what the basic car draws in the episodes that crossings are, uniform in [0, 1)."""
    seed, count = crossing_plan.plan.seed, 2 * crossing_plan.ticks
    found = np.empty((len(crossings), 1 + count))
    for row, (phi, draw) in enumerate(zip(crossings.phi.tolist(), crossings.draw.tolist(), strict=True)):
        number = episode_id(EpisodeGroup.RISK, phi, draw)
        found[row, 0] = generator(seed, number, Role.START).random()
        found[row, 1:] = generator(seed, number, Role.CAR).random(count)
    return found


def warm_up_risk(plan: Plan) -> None:
    """Compile what crossings of a known car need, before it is timed or forked."""
    if not _has_exact_margin(plan):
        return
    from skd_adversary.adversary import warm_up_episodes
    from skd_sim.world.episode import Mode

    episode = next(one for one in warm_up_episodes() if one.mode == Mode.KAMIKAZE)
    assert episode.safe_trajectory is not None
    here = replace(plan, scenario=episode.scenario)
    crossing_plan = CrossingPlan(here, (episode.safe_trajectory,), np.ones(12) * 0.1)
    car, crossings = KnownCar(crossing_plan), crude_crossings(crossing_plan, 2)
    car.run_drawn(crossings, draws_of(crossing_plan, crossings), 1.0)


@stage(80)
def run(context: Context, assessment: Assessment) -> Assessment:
    """Return the assessment with the risk of the car, or why there is none."""
    request, plan = context.risk, assessment.for_deviation.plan
    why, external = why_no_risk(plan, request.behaviour), plan.car.is_external
    if not why and external and not context.repeats:
        why = "the risk of a node of its own takes episodes in lockstep: leave out --pacing real_time"
    if not why and external and 2 * len(assessment.reasons) > assessment.episodes:
        why = "most episodes were aborted, and so would be those of the risk"
    if why or request.behaviour is None:
        return replace(assessment, risk_note=why)
    crossing_plan = CrossingPlan(plan, assessment.safe, request.behaviour.values)
    try:
        hits: dict[float, dict[int, EpisodeLog]] = {}
        scales = list(_scales(crossing_plan, context, assessment.confidence, hits))
        failures, failing = _failures(crossing_plan, scales, hits, context.workers)
    except AssessmentError as error:
        return assessment.failed(error, risk_note=f"its crossings ended: {error}")
    return replace(assessment, risks=Risks(request.behaviour.as_dict(), scales, failures, failing))


def _scales(
    crossing_plan: CrossingPlan, context: Context, confidence: float, hits: dict[float, dict[int, EpisodeLog]]
) -> Iterator[ScaleRisk]:
    """Yield the risk at each scale, and put into `hits` by scale and number the crossings run as episodes that hit."""
    plan, workers, progress = crossing_plan.plan, context.workers, context.progress
    runs = runs_of(plan, context.risk, graph=plan.car.is_external)
    known = KnownCar(crossing_plan) if _has_exact_margin(plan) else None
    crossings, total = crude_crossings(crossing_plan, runs), runs * len(SCALES)
    draws = None if known is None else draws_of(crossing_plan, crossings)
    together = None if known is not None else batched_car(crossing_plan, workers)
    other = AnyCar(crossing_plan, context.runner if plan.car.is_external else workers)
    effort = SubsetEffort()
    for number, scale in enumerate(SCALES):
        if known is not None and draws is not None:
            ends = known.run_drawn(crossings, draws, scale)
            progress(LABEL, (number + 1) * runs, total)
        elif together is not None:
            ends = together.run(crossings, scale)
            progress(LABEL, (number + 1) * runs, total)
        else:
            parts, mine = [], hits.setdefault(scale, {})
            for first in range(0, runs, _AT_A_TIME):
                rows = np.arange(first, min(first + _AT_A_TIME, runs))
                parts.append(other.run(crossings.of(rows), scale))
                mine |= dict(zip(rows[parts[-1].touch == Touch.FRONT].tolist(), other.hits, strict=True))
                progress(LABEL, number * runs + int(rows[-1]) + 1, total)
            ends = Ends.together(parts)
        subsets, lost = None, 0
        if int((ends.touch == Touch.FRONT).sum()) < FEW_HITS and (
            context.risk.subset or (known is not None and runs >= RUNS)
        ):
            unknown = None if known is not None else together or other
            try:
                subsets = _subsets(crossing_plan, scale, effort, workers, unknown, progress)
            except AbortedCrossingsError as error:
                lost = error.count
        yield ScaleRisk(scale, ends.touch, len(crossing_plan.safe), subsets, confidence, ends.ticks, lost)


def _failures(
    crossing_plan: CrossingPlan,
    scales: Sequence[ScaleRisk],
    hits: Mapping[float, Mapping[int, EpisodeLog]],
    runner: Runner,
) -> tuple[Failures | None, dict[int, EpisodeLog]]:
    """Return the most likely failures and the logs of those that are kept; compiled crossings are run for these."""
    found = failures_of(scales, walkers_of(crossing_plan))
    if found is None:
        return None, {}
    rows = sorted(one.row for one in found.nearest)
    if hits:
        logs = {row: hits[found.scale][row] for row in rows}
    else:
        chosen = crude_crossings(crossing_plan, rows[-1] + 1).of(np.array(rows))
        logs = dict(zip(rows, runner.run(AnyCar(crossing_plan, runner).episodes(chosen, found.scale)), strict=True))
        missed = [row for row, log in logs.items() if end_of(log)[0] != Touch.FRONT]
        if missed:
            where = f"crossing {missed[0]} at scale {found.scale:g}"
            raise AssessmentError(f"of {where} command makes no hit and commands does: both have to be the same car")
    return found.with_speeds({row: log.impact_speed for row, log in logs.items()}), logs


def _subsets(
    crossing_plan: CrossingPlan,
    scale: float,
    effort: SubsetEffort,
    runner: Workers,
    other: CrossingModel | None,
    progress: Progress,
) -> Subsets:
    """Return what subset simulation finds; `other` runs crossings of a car that is not known.

    Raises:
        AbortedCrossingsError: crossings of it were aborted.
    """
    found: list[Replicate] = []
    model = KnownCar(crossing_plan) if other is None else other
    levels = levels_of(crossing_plan, model, scale, effort)
    one_of_them = partial(replicate, crossing_plan, model, scale, effort, levels)
    numbers = range(effort.replicates)
    results = runner.map(one_of_them, numbers) if other is None else map(one_of_them, numbers)
    for count, one in enumerate(results, start=1):
        found.append(one)
        progress(f"{LABEL}, R({scale:g})", count, effort.replicates)
    return gathered(found, effort)


NOT_REQUESTED: Final = f"--behaviour {NO_BEHAVIOUR}: the risk was not requested"


def risk_request(behaviour: str, runs: int | None = None, *, subset: bool = False) -> RiskRequest:
    """Return what options ask.

    Raises:
        UsageError: there is no such behaviour model, or it was changed in the folder in which it was written; or the
            risk is not asked for, and how to find it is.
    """
    if behaviour != NO_BEHAVIOUR:
        return RiskRequest(unchanged_behaviour(behaviour), runs, subset)
    if runs is not None or subset:
        option = "risk_subset" if runs is None else f"risk_runs {runs}"
        raise UsageError(f"{option}: --behaviour {NO_BEHAVIOUR} asks for no risk; leave one of them away")
    return RiskRequest()


def unchanged_behaviour(name: str) -> Behaviour:
    """Return the behaviour model of a name, file or folder, as `skd fit --people` wrote it.

    Raises:
        UsageError: there is no such behaviour model, or it was changed in the folder in which it was written.
    """
    behaviour = load_behaviour(name)
    check_unchanged(file_of(name).parent, [file_of(name).name])
    return behaviour


def single_crossing(plan: Plan, behaviour: Behaviour, safe_number: int, trial: int, scale: float) -> EpisodeSpec:
    """Return a crossing of a plan's risk as an episode.

    Args:
        plan: plan of the assessment.
        behaviour: how people walk.
        safe_number: number of φ among those of the plan, counted from 0.
        trial: number of the draws of walker and car on it.
        scale: by which the walker's normals are multiplied.

    Raises:
        UsageError: the plan has no risk.
    """
    if why := why_no_risk(plan, behaviour):
        raise UsageError(f"--mode risk: {why}")
    runner = InProcessRunner(1)
    safe = tuple(safe_trajectories(plan, runner))
    crossing_plan = CrossingPlan(plan, safe, behaviour.values)
    normals = walkers_of(crossing_plan).normals(safe_number + trial * len(safe))
    one = Crossings(np.array([safe_number]), normals[None], np.empty((1, 0)), np.array([trial]))
    return AnyCar(crossing_plan, runner).episodes(one, scale)[0]
