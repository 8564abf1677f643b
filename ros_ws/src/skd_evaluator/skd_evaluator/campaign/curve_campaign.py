"""The vulnerability curve of a rating: from its attempts, and from kamikazes that are held to a budget."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from skd_sim.episode import Episode, Mode, Outcome

from skd_evaluator.campaign.assessment import Assessment
from skd_evaluator.campaign.plan import EpisodeRunner, Plan, Progress
from skd_evaluator.campaign.rating import Rating
from skd_evaluator.measure.deformation import deformation
from skd_evaluator.measure.statistics import FloatArray
from skd_evaluator.measure.vulnerability_curve import (
    Vulnerability,
    VulnerabilityCurve,
    budget_points,
    vulnerability_curve,
)

BUDGETS = (0.25, 0.5, 1.0, 2.0)
"""η, m, to which kamikazes are held."""
_PART = 4
"""One in so many of an assessment's attempts is made for each budget."""


def curve_of(assessment: Assessment) -> VulnerabilityCurve | None:
    """Return the curve of an assessment's attempts; None without any."""
    rows = assessment.deformation.per_safe_trajectory
    return vulnerability_curve([row.restricted for row in rows], assessment.deformation.eta_max)


def held_attempts(plan: Plan) -> int:
    """Return how many kamikazes are held to each η, for each φ."""
    return max(1, -(-plan.kamikaze_count // _PART))


def held_to(assessment: Assessment, eta: float, runner: EpisodeRunner) -> tuple[float, int, int]:
    """Run kamikazes that plan for a deformation of at most η; return η, how many collided within it, and of how many.

    Their number is fixed beforehand: to go on until enough have collided would make the share too high.
    """
    plan = replace(assessment.plan, maximum_distance=eta)
    each = held_attempts(plan)
    episodes: list[Episode] = [
        plan.episode(Mode.KAMIKAZE, index, attempt, phi)
        for index, phi in enumerate(assessment.safe)
        for attempt in range(each)
    ]
    successes = attempts = 0
    for log in runner.run(episodes):
        attempts += log.outcome != Outcome.ABORTED
        if log.outcome == Outcome.COLLISION:
            phi = log.episode.safe_trajectory
            assert phi is not None
            ticks = log.impact_time / plan.scenario.time_step
            successes += deformation(phi.positions, log.trajectory.positions, ticks) <= eta
    return eta, successes, attempts


def with_vulnerability(rating: Rating, runner: EpisodeRunner, progress: Progress) -> Rating:
    """Return the rating with its vulnerability curves, for which more kamikazes are run.

    Those of `deformation` alone can be held to a budget. Where their floors are known, so is the curve of the best.
    """
    begin = time.perf_counter()
    assessment = rating.for_deformation
    curve = curve_of(assessment)
    if curve is None:
        return rating
    points: list[tuple[float, int, int]] = []
    if assessment.plan.limits_deformation:
        for number, eta in enumerate(BUDGETS, start=1):
            points.append(held_to(assessment, eta, runner))
            progress("kamikazes held to η", number, len(BUDGETS))
    least = attempt_floors(assessment)
    floors = None if least is None else vulnerability_curve(least, curve.eta_max)
    found = Vulnerability(curve, tuple(budget_points(points)), floors)
    return replace(rating, vulnerability=found, seconds=rating.seconds + time.perf_counter() - begin)


def attempt_floors(assessment: Assessment) -> list[FloatArray] | None:
    """Return per φ the least deformation of each attempt's episode, m, failed ones last; infinite: none collides.

    None where they were not asked for.
    """
    if assessment.floors is None or assessment.missed_floors is None:
        return None
    pairs = np.cumsum([row.pairs for row in assessment.skd.per_safe_trajectory])[:-1]
    misses = np.cumsum([len(group.misses) for group in assessment.kamikaze])[:-1]
    rows = zip(np.split(assessment.floors, pairs), np.split(assessment.missed_floors, misses), strict=True)
    return [np.nan_to_num(np.concatenate(row), nan=np.inf) for row in rows]
