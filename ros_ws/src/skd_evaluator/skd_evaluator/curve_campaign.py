"""The vulnerability curve of a rating: from its attempts, and from kamikazes that are held to a budget."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from skd_sim.episode import Episode, Mode, Outcome
from skd_sim.objective import Objective

from skd_evaluator.assessment import Assessment
from skd_evaluator.campaign import EpisodeRunner, Progress
from skd_evaluator.deformation import deformation
from skd_evaluator.vulnerability_curve import BudgetPoint, VulnerabilityCurve, budget_points, vulnerability_curve

BUDGETS = (0.25, 0.5, 1.0, 2.0)
"""η, m, to which kamikazes are held."""
_PART = 4
"""One in so many of an assessment's attempts is made for each budget."""


@dataclass(frozen=True, eq=False)
class Vulnerability:
    """The curves of a car.

    Attributes:
        kamikazes: of the attempts of the assessment.
        budgets: of kamikazes that were planned for a largest deformation; none where the objective is another.
        floors: of clairvoyant kamikazes in the same episodes; None where they were not asked for.
    """

    kamikazes: VulnerabilityCurve
    budgets: tuple[BudgetPoint, ...] = ()
    floors: VulnerabilityCurve | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the entry of assessment.json."""
        return {
            "kamikazes": self.kamikazes.as_dict(),
            "budgets": [point.as_dict() for point in self.budgets],
            "floors": None if self.floors is None else self.floors.as_dict(),
        }


def curve_of(assessment: Assessment) -> VulnerabilityCurve | None:
    """Return the curve of an assessment's attempts; None without any."""
    rows = assessment.deformation.per_safe_trajectory
    return vulnerability_curve(
        [row.restricted for row in rows], assessment.deformation.eta_max, seed=assessment.plan.seed
    )


def held_to(assessment: Assessment, eta: float, runner: EpisodeRunner) -> tuple[float, int, int]:
    """Run kamikazes that plan for a deformation of at most η; return η, how many collided within it, and of how many.

    Their number is fixed beforehand: to go on until enough have collided would make the share too high.
    """
    plan = replace(assessment.plan, maximum_distance=eta)
    each = max(1, -(-plan.kamikaze_count // _PART))
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


def vulnerability(
    assessment: Assessment,
    runner: EpisodeRunner,
    progress: Progress,
    floors: Sequence[np.ndarray[Any, np.dtype[np.float64]]] | None = None,
) -> Vulnerability | None:
    """Return the curves of an assessment; None without an attempt.

    Args:
        assessment: by kamikazes of any objective; those of `deformation` alone can be held to a budget.
        runner: of the kamikazes that are held to one.
        progress: told how far it is.
        floors: per φ, the least deformation of each attempt's episode, m, infinite where none collides.
    """
    curve = curve_of(assessment)
    if curve is None:
        return None
    points: list[tuple[float, int, int]] = []
    if assessment.plan.objective == Objective.DEFORMATION:
        for number, eta in enumerate(BUDGETS, start=1):
            points.append(held_to(assessment, eta, runner))
            progress("kamikazes held to η", number, len(BUDGETS))
    best = None if floors is None else vulnerability_curve(floors, curve.eta_max, seed=curve.seed)
    return Vulnerability(curve, tuple(budget_points(points)), best)
