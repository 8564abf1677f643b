"""Which episodes an assessment has, and with what."""

from __future__ import annotations

from typing import TYPE_CHECKING

from skd_sim.public import exported

if TYPE_CHECKING:
    from skd_evaluator.assessment.plan.plan import Plan as Plan
    from skd_evaluator.assessment.plan.plan import safe_trajectories as safe_trajectories

__all__ = ["Plan", "safe_trajectories"]

_WHERE = {
    "Plan": "skd_evaluator.assessment.plan.plan",
    "safe_trajectories": "skd_evaluator.assessment.plan.plan",
}
__getattr__, __dir__ = exported(__name__, _WHERE)
