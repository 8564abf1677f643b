"""What a simulator other than SKD's own world says of the car in it, which results keep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

from skd_sim.options.car_under_test import is_own_world
from skd_sim.scenario.scenario import Scenario
from skd_sim.simulators.simulator import make_simulator
from skd_sim.world.episode import AbortKind, kind_of

from skd_evaluator.assessment.judge.rating import Rating
from skd_evaluator.assessment.run.workers import ExecutorRunner

_STRAYED: Final = 0.01
"""m: far more than another simulator rounds, and less than any figure shows."""


def described(simulator_and_scenario: tuple[str, Scenario]) -> Mapping[str, Any] | None:
    """Return, as plain data, what a simulator says of a scenario's car; None where it says nothing.

    A simulator says it by a method `described(scenario)`.
    """
    name, scenario = simulator_and_scenario
    describe = getattr(make_simulator(name), "described", None)
    return dict(describe(scenario)) if callable(describe) else None


def with_simulation(rating: Rating, runner: ExecutorRunner) -> Rating:
    """Return the rating with what its simulator says of the car, asked in a process that may run it.

    So it is warned of episodes that cannot have happened, and of an adversary that does not go quite as it is told.

    Args:
        rating: the rating, whose episodes have been run.
        runner: asks, where it runs episodes.
    """
    plan = rating.plan
    if is_own_world(plan.simulator):
        return rating
    said = next(iter(runner.map(described, [(plan.simulator, plan.scenario)])))
    return replace(rating, simulation=said, warnings=(*rating.warnings, *_warnings(rating, plan.simulator)))


def _warnings(rating: Rating, simulator: str) -> tuple[str, ...]:
    """Return what a reader should know of what a simulator said in the episodes of a rating, a line each."""
    found = []
    refuted = [one for one in rating.reasons if kind_of(one) in (AbortKind.REFUTED, AbortKind.NOT_FINITE)]
    if refuted:
        found.append(
            f"{len(refuted)} of {rating.episodes} episodes in simulator {simulator} cannot have happened, and "
            f"count for nothing ({refuted[0]})"
        )
    logs = [*rating.kamikaze_logs, *rating.replays]
    strayed = [log.strayed for log in logs if log.strayed > _STRAYED]
    if strayed:
        found.append(
            f"in {len(strayed)} of {len(logs)} episodes in simulator {simulator} the adversary was not where it had "
            f"been told to go, by up to {max(strayed):.2g} m: it obeys later than at once, or not quite"
        )
    return tuple(found)
