"""Single stages of an assessment, for tests that need no more than these."""

from collections.abc import Sequence
from typing import Any

from skd_evaluator import Assessment, Plan
from skd_evaluator.assessment.context import Context, RiskRequest, Runner
from skd_evaluator.assessment.stages import kamikazes, margin, risk
from skd_sim.options.car_and_adversary import Objective
from skd_sim.world.state import Trajectory


def rate(plan: Plan, objectives: Sequence[Objective], safe: Sequence[Trajectory], runner: Runner) -> Assessment:
    """Return the kamikazes of some objectives, and the runs along φ."""
    nobody: Any = None
    context = Context(runner, nobody, tuple(objectives))
    return kamikazes.run_nominal(context, kamikazes.run(context, Assessment(plan, tuple(safe))))


def with_margins(assessment: Assessment, workers: Any, limit: int) -> Assessment:
    """Return the assessment with its margin, for which so many candidates may be driven in a trial."""
    return margin.run(Context(workers, workers, margin_limit=limit), assessment)


def with_risks(assessment: Assessment, request: RiskRequest, workers: Any, runner: Runner | None = None) -> Assessment:
    return risk.run(Context(runner or workers, workers, risk=request), assessment)
