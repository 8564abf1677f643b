"""What a simulator other than SKD's own world says of the car in it, which results keep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from skd_sim.choices.simulators import is_own_world
from skd_sim.encounter.scenario import Scenario
from skd_sim.simulation.named_simulator import make_simulator

from skd_evaluator.campaign.judge.rating import Rating
from skd_evaluator.campaign.run.executor_runner import ExecutorRunner


def described(simulator_and_scenario: tuple[str, Scenario]) -> Mapping[str, Any] | None:
    """Return, as plain data, what a simulator says of a scenario's car; None where it says nothing.

    A simulator says it by a method `described(scenario)`.
    """
    name, scenario = simulator_and_scenario
    describe = getattr(make_simulator(name), "described", None)
    return dict(describe(scenario)) if callable(describe) else None


def with_simulation(rating: Rating, runner: ExecutorRunner) -> Rating:
    """Return the rating with what its simulator says of the car, asked in a process that may run it.

    Args:
        rating: the rating, whose episodes have been run.
        runner: asks, where it runs episodes.
    """
    plan = rating.plan
    if is_own_world(plan.simulator):
        return rating
    return replace(rating, simulation=next(iter(runner.map(described, [(plan.simulator, plan.scenario)]))))
