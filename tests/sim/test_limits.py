"""Commands end where brakes and tyres end; what is within stays as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.world.dynamics.basic import GRIP, command_limits
from skd_sim.world.world import World

CROSSING = load_scenario("crossing")
MULTI_BODY = load_scenario("crossing_multi_body")


def car(scenario: Scenario, **changes: float) -> Scenario:
    return replace(scenario, car=replace(scenario.car, **changes))


def world(scenario: Scenario) -> World:
    return World(scenario, start_rng=np.random.default_rng(1), car_rng=np.random.default_rng(2))


def test_limits_by_hand() -> None:
    assert pytest.approx(11.5, abs=0.05) == GRIP  # a friction coefficient of 1.17, as of a good tyre on a dry road
    assert command_limits(CROSSING) == (-GRIP, GRIP)
    assert command_limits(car(CROSSING, brake_limit=6.0)).least == -6.0
    assert command_limits(car(CROSSING, brake_limit=2.0)).least == -3.5  # what the scenario says that this car can do
    assert command_limits(car(CROSSING, deceleration=15.0)).least == -15.0
    assert command_limits(MULTI_BODY) == (-15.0, GRIP)  # its own tyres do the rest
    wet = replace(MULTI_BODY, road=replace(MULTI_BODY.road, friction=0.5))
    assert command_limits(wet).greatest == 0.5 * GRIP


@pytest.mark.parametrize("scenario", [CROSSING, MULTI_BODY], ids=["basic", "multi-body"])
def test_a_command_beyond_is_the_limit_and_is_counted(scenario: Scenario) -> None:
    limits = command_limits(scenario)
    for beyond, limit in ((-200.0, limits.least), (1e300, limits.greatest)):
        one, other = world(scenario), world(scenario)
        one.step(beyond, (0.0, 0.0))
        other.step(limit, (0.0, 0.0))
        assert one.car == other.car
        assert (one.clipped, other.clipped) == (1, 0)
        one.step(limit, (0.0, 0.0))
        assert one.clipped == 1
