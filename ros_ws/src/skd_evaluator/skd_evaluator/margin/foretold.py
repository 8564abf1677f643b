"""Of which cars it is known beforehand what they answer to every sequence of actions: their margin is exact."""

from __future__ import annotations

from skd_sim.car_under_test import CarUnderTest
from skd_sim.dynamics.kinds import DYNAMICS
from skd_sim.encounter.scenario import Scenario


def foretold(car: CarUnderTest, scenario: Scenario) -> bool:
    """Tell whether it is known what a car answers to every sequence of actions.

    That is the basic car, deciding once a tick, on a straight road and beside an adversary that is a disc.
    """
    known_car = car.is_known and DYNAMICS[scenario.car.dynamics].known and scenario.control_periods == 1
    return known_car and scenario.road.straight and not scenario.pedestrian.is_box
