"""The stages of an assessment, in order of their places; the same in process, through the graph and on a cluster."""

from __future__ import annotations

import importlib
import pkgutil
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

from skd_adversary.adversary import any_car_models, warm_up_episodes
from skd_sim.options.car_and_adversary import DEFAULT_OBJECTIVES, Objective
from skd_sim.options.registry import Registry
from skd_sim.world.episode import EpisodeSpec

from skd_evaluator.assessment import stages as modules
from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.context import STAGES, Context
from skd_evaluator.assessment.options import GENERATED
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages import car_model, margin, risk, safe_trajectories

Stage = Callable[[Context, Assessment], Assessment]
"""Adds to what is known of a car; one whose results are known already leaves them as they are."""
REGISTERED: Final = Registry("stage", "skd.stages", {})
"""Stages of installed packages, functions as those above; they come last, in the order of their names."""


def stages() -> list[Stage]:
    """Return the stages of an assessment, in order: those of the modules of this folder, then those of packages.

    Raises:
        UsageError: one of an installed package cannot be loaded.
    """
    for one in pkgutil.iter_modules(modules.__path__, f"{modules.__name__}."):
        importlib.import_module(one.name)
    own = [found for _, found in sorted(STAGES.items())]
    return [*own, *map(REGISTERED.find, REGISTERED.names())]


def run_stages(context: Context, assessment: Assessment) -> Assessment:
    """Return the assessment after all stages.

    Args:
        context: what they are given; its workers have been started.
        assessment: what is known: at least the plan.
    """
    begin = time.perf_counter()
    for stage in stages():
        assessment = stage(context, assessment)
    return replace(assessment, seconds=assessment.seconds + time.perf_counter() - begin)


def assess_in_process(context: Context, assessment: Assessment) -> Assessment:
    """Return the assessment after all stages, whose workers are started, after all that can be compiled, and ended."""
    with context.workers:
        # Recorded φ are read first: bad input is said before anything is compiled.
        if assessment.plan.safe not in GENERATED and context.until_width is None:
            assessment = safe_trajectories.run(context, assessment)
        start_workers(context, assessment.plan)
        return run_stages(context, assessment)


def start_workers(context: Context, plan: Plan) -> None:
    """Start the workers of a context, after all that an assessment needs has been compiled."""
    with margin.margins_compiled_in_background(needed=context.margin_limit > 0) as load_margins:
        if context.risk.behaviour is not None:
            risk.warm_up_risk(plan)
        context.workers.start(planners_of(plan, context.objectives), inherited=load_margins)


def compile_for_graph(plan: Plan, objectives: Sequence[Objective]) -> None:
    """Compile planners into the disk cache: in its first episode the adversary's node would be silent for too long.

    Those of a basic car whose C is known, by the default objectives, that node compiles itself at its start.
    """
    modelled = bool(plan.car_model) or car_model.needs_learning(plan)
    missing = [one for one in objectives if modelled or one not in DEFAULT_OBJECTIVES]
    if missing:
        InProcessRunner(1).start(planners_of(plan, missing))


def planners_of(plan: Plan, objectives: Sequence[Objective]) -> list[EpisodeSpec]:
    """Return short episodes that make the planners of a plan compile, by each of some objectives."""
    models, needed = [plan.car_model], list(objectives)
    if car_model.needs_learning(plan):  # of whatever kind its model will be, and by the kamikazes from which it learns
        models, needed = any_car_models(), list(dict.fromkeys([*objectives, *DEFAULT_OBJECTIVES]))
    return [
        episode
        for objective in needed
        for model in models
        for episode in warm_up_episodes(
            plan.controller, objective=objective, car_model=model, dynamics=plan.scenario.car.dynamics
        )
    ]
