from __future__ import annotations

import numpy as np
import pytest
from skd_sim.controllers.carla_agent import CarlaAgent, speed_factor
from skd_sim.scenario.road import HEADING_NORTH
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.state import AdversaryState, CarState, next_speed, travelled

CROSSING = load_scenario("crossing")


@pytest.mark.parametrize(
    ("distance", "angle", "factor"),
    [
        (11.99, 0.0, 0.0),
        (11.99, -0.499, 0.0),
        (11.99, 0.501, 1.0),
        (12.0, 0.0, 12.0 / 70.0),
        (34.99, 0.149, 34.99 / 70.0),
        (34.99, -0.151, 1.0),
        (35.0, 0.0, 1.0),
    ],
)
def test_published_zones(distance, angle, factor):
    assert speed_factor(distance, angle) == pytest.approx(factor)


def agent() -> CarlaAgent:
    controller = CarlaAgent()
    controller.reset(CROSSING, np.random.default_rng(0))
    return controller


def test_full_stop_for_one_near_on_the_lane_and_none_beside_it():
    car = CarState(0.0, -10.0, HEADING_NORTH, 25.0 / 3.0)
    assert agent().command(car, AdversaryState(1.7, 0.0, 0.0, 0.0)) == -CROSSING.car.deceleration
    assert agent().command(car, AdversaryState(1.8, 0.0, 0.0, 0.0)) > 0.0
    behind = AdversaryState(0.0, -20.0, 0.0, 0.0)
    assert agent().command(car, behind) > 0.0


def cruise(controller: CarlaAgent, ahead: float, ticks: int) -> float:
    """Keep an adversary at a distance; return the speed that the car settles at, m/s."""
    y, speed = 0.0, 25.0 / 3.0
    for _ in range(ticks):
        acceleration = controller.command(
            CarState(0.0, y, HEADING_NORTH, speed), AdversaryState(0.0, y + ahead, 0.0, 0.0)
        )
        after = next_speed(speed, acceleration, 0.0, 0.3)
        y += travelled(speed, after, 0.3)
        speed = after
    return speed * 3.6


def test_target_speeds():
    """36 km/h on a free road, 36·30/70 km/h with an adversary 30 m ahead."""
    assert cruise(agent(), 1e4, 200) == pytest.approx(36.0, abs=0.5)
    assert cruise(agent(), 30.0, 300) == pytest.approx(36.0 * 30.0 / 70.0, abs=1.0)
