"""One episode of a plan by itself, the same that a campaign would run."""

from __future__ import annotations

from skd_sim.episode.episode import Episode, Mode
from skd_sim.geometry.trajectory import Trajectory

from skd_evaluator.campaign.plan.plan import Plan, safe_trajectories
from skd_evaluator.campaign.run.workers import InProcessRunner


def single_episode(
    plan: Plan, mode: Mode, attempt: int, safe: Trajectory | None = None, safe_number: int = 0
) -> Episode:
    """Return one episode of a plan, the same that a campaign would run.

    Args:
        plan: plan of the assessment.
        mode: what the adversary does.
        attempt: number of the attempt within its stage and φ.
        safe: φ, if it is known already; only modes kamikaze and replay need it.
        safe_number: number of φ among those of the plan, counted from 0; of no meaning in safe mode.
    """
    if mode == Mode.SAFE:
        return plan.episode(mode, 0, attempt, None)
    if safe is None:
        safe = safe_trajectories(plan, InProcessRunner(1))[safe_number]
    return plan.episode(mode, safe_number, attempt, safe)
