"""One crossing of the risk by itself, the same that an assessment runs."""

from __future__ import annotations

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.world.episode import Episode

from skd_evaluator.assessment.plan.plan import Plan, safe_trajectories
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.metrics.behaviour.model import Behaviour
from skd_evaluator.risk.any_car import AnyCar
from skd_evaluator.risk.assessment_risk import walkers_of, why_no_risk
from skd_evaluator.risk.crossings import CrossingPlan, Crossings


def single_crossing(plan: Plan, behaviour: Behaviour, safe_number: int, trial: int, scale: float) -> Episode:
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
