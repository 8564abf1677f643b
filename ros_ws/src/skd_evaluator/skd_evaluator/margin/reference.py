"""The reference sweep of a scenario: the margins of basic cars of several C, in the same trials.

Where these are exact the equivalent multiplier needs none of it (`basic_margins.py`). Elsewhere they are searched for,
as that of the car under test is: both are upper bounds, found by the same search. The basic cars are the paper's, which
decide once a tick; on a road with curves they move as the car under test.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from skd_sim.errors import UsageError
from skd_sim.options.adversary import Objective
from skd_sim.scenario.scenario import scenario_from_dict
from skd_sim.world.episode import Mode
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.files.assessment_json import ASSESSMENT
from skd_evaluator.assessment.files.results import StoredResult
from skd_evaluator.assessment.plan import Plan, Progress
from skd_evaluator.assessment.run.workers import Workers
from skd_evaluator.margin.assessment_margin import least_ways
from skd_evaluator.margin.basic_margins import yardstick
from skd_evaluator.metrics.equivalent_multiplier import EquivalentMultiplier, equivalent_multiplier
from skd_evaluator.metrics.margins import Margins

MULTIPLIERS = (0.5, 0.75, 1.0, 1.25, 1.5)


@dataclass(frozen=True, eq=False)
class Asked:
    """Where basic cars are compared.

    Attributes:
        name: of the scenario, or the folder of the assessment.
        plan: of the trials; its `kamikaze_count` is how many there are on each φ.
        safe: Φ.
        result: the assessment whose car is compared with them; None: no car is.
    """

    name: str
    plan: Plan
    safe: Sequence[Trajectory]
    result: StoredResult | None = None


def asked_of_result(result: StoredResult) -> Asked:
    """Return the trials in which an assessment has margins.

    Raises:
        UsageError: it has none.
    """
    groups = result.groups.get("margin", ())
    if not groups:
        raise UsageError(f"{result.folder}: has no margin to compare with those of basic cars")
    scenario = scenario_from_dict(result.figures["scenario"], f"scenario in {result.folder / ASSESSMENT}")
    count = min(len(one) for one in groups)
    plan = Plan(scenario, objective=Objective.DEVIATION, seed=int(result.figures["seed"]), kamikaze_count=count)
    safe = [Trajectory(one, scenario.time_step, f"φ {number}") for number, one in enumerate(result.safe)]
    return Asked(str(result.folder), plan, safe, result)


def reference_sweep(
    asked: Asked, multipliers: Sequence[float], runner: Workers, progress: Progress, limit: int
) -> dict[float, Margins]:
    """Return the margins of the basic cars with some C.

    Args:
        asked: where.
        multipliers: the C.
        runner: computes margins, in several processes.
        progress: called with how far the work is.
        limit: candidates that may be driven in a trial.
    """
    found = {}
    for multiplier in multipliers:
        plan = yardstick(asked.plan, multiplier)
        count = plan.kamikaze_count
        episodes = [
            plan.episode(Mode.KAMIKAZE, index, trial, phi)
            for index, phi in enumerate(asked.safe)
            for trial in range(count)
        ]

        def told(_label: str, done: int, total: int, multiplier: float = multiplier) -> None:
            progress(f"{asked.name}, C = {multiplier:g}", done, total)

        ways = least_ways(episodes, {}, runner, told, limit)
        grouped = tuple(tuple(ways.ways[start : start + count]) for start in range(0, len(episodes), count))
        found[multiplier] = Margins(grouped, plan.scenario.eta_max, ways.budget, ways.converged, ways.excess)
    return found


def equivalent_in(asked: Asked, basic: Mapping[float, Margins]) -> EquivalentMultiplier | None:
    """Return the C of the basic car that has the margin of the assessment's car; None without an assessment."""
    if asked.result is None or len(basic) < 2:
        return None
    return equivalent_multiplier(asked.result.groups["margin"], {one: found.per_phi for one, found in basic.items()})
