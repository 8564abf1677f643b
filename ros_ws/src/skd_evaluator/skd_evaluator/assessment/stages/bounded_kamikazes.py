"""Points of the vulnerability curve: kamikazes that may not stray further than a given deviation, their budget."""

from __future__ import annotations

import time
from dataclasses import replace

from skd_sim.world.episode import Episode, Mode, Outcome

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.objective_result import ObjectiveResult
from skd_evaluator.assessment.plan import Plan, Progress, Runner
from skd_evaluator.metrics.deviation import deviation
from skd_evaluator.metrics.vulnerability_curve import BudgetPoint, budget_points

BUDGETS = (0.25, 0.5, 1.0, 2.0)
"""η, m, to which kamikazes are held."""
_PART = 4
"""One in so many of an assessment's trials is made for each budget."""


def held_trials(plan: Plan) -> int:
    """Return how many kamikazes are held to each η, for each φ."""
    return max(1, -(-plan.kamikaze_count // _PART))


def held_to(assessment: ObjectiveResult, eta: float, runner: Runner) -> BudgetPoint:
    """Run kamikazes that plan for a deviation of at most η; return how many were hit within it, and of how many.

    Their number is fixed beforehand: to go on until enough have collided would make the share too high.
    """
    plan = replace(assessment.plan, maximum_distance=eta)
    each = held_trials(plan)
    episodes: list[Episode] = [
        plan.episode(Mode.KAMIKAZE, index, trial, phi)
        for index, phi in enumerate(assessment.safe)
        for trial in range(each)
    ]
    successes = aborted = 0
    for log in runner.run(episodes):
        aborted += log.outcome == Outcome.ABORTED
        if log.hit:
            phi = log.episode.safe_trajectory
            assert phi is not None
            ticks = log.impact_time / plan.scenario.time_step
            successes += deviation(phi.positions, log.trajectory.positions, ticks) <= eta
    return BudgetPoint(eta, successes, len(episodes) - aborted, aborted)


def with_budgets(rating: Assessment, runner: Runner, progress: Progress) -> Assessment:
    """Run kamikazes that are held to a budget, for several budgets, and return the rating with these points.

    Only kamikazes of objective `deviation` can be held to one.
    """
    begin = time.perf_counter()
    assessment = rating.for_deviation
    if not assessment.plan.limits_deviation or not assessment.trials:
        return rating
    points: list[BudgetPoint] = []
    for number, eta in enumerate(BUDGETS, start=1):
        points.append(held_to(assessment, eta, runner))
        progress("kamikazes held to η", number, len(BUDGETS))
    return replace(
        rating,
        budgets=tuple(budget_points(points)),
        seconds=rating.seconds + time.perf_counter() - begin,
    )
