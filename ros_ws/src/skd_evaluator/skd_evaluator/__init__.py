"""The evaluator: assessments, their figures, and what is recorded and reported of them.

What stands in `__all__` is for users and stays where it is; modules below may move.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from skd_sim.public import exported

if TYPE_CHECKING:
    from skd_evaluator.assessment.assessment import Assessment as Assessment
    from skd_evaluator.assessment.plan import Plan as Plan
    from skd_evaluator.assessment.run.episodes import run_episode as run_episode
    from skd_evaluator.errors import AssessmentError as AssessmentError
    from skd_evaluator.library import assess as assess
    from skd_evaluator.library import load_result as load_result
    from skd_evaluator.metrics.clustered import clustered_mean as clustered_mean
    from skd_evaluator.metrics.clustered import clustered_rate as clustered_rate
    from skd_evaluator.metrics.deviation import deviation as deviation
    from skd_evaluator.metrics.difference import difference as difference
    from skd_evaluator.metrics.frechet import discrete_frechet as discrete_frechet
    from skd_evaluator.metrics.measures import Measure as Measure

__all__ = [
    "Assessment",
    "AssessmentError",
    "Measure",
    "Plan",
    "assess",
    "clustered_mean",
    "clustered_rate",
    "deviation",
    "difference",
    "discrete_frechet",
    "load_result",
    "run_episode",
]

_WHERE = {
    "AssessmentError": "skd_evaluator.errors",
    "Measure": "skd_evaluator.metrics.measures",
    "Plan": "skd_evaluator.assessment.plan",
    "Assessment": "skd_evaluator.assessment.assessment",
    "assess": "skd_evaluator.library",
    "clustered_mean": "skd_evaluator.metrics.clustered",
    "clustered_rate": "skd_evaluator.metrics.clustered",
    "deviation": "skd_evaluator.metrics.deviation",
    "difference": "skd_evaluator.metrics.difference",
    "discrete_frechet": "skd_evaluator.metrics.frechet",
    "load_result": "skd_evaluator.library",
    "run_episode": "skd_evaluator.assessment.run.episodes",
}
__getattr__, __dir__ = exported(__name__, _WHERE)
