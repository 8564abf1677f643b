"""highway-env's Intelligent Driver Model as the car under test: its own vehicle on its own road decides.

Nothing of the law is here: `IDMVehicle.act` looks for who leads, asks `IDMVehicle.acceleration` and bounds the answer.
"""

from __future__ import annotations

import numpy as np
from highway_env.road.lane import StraightLane
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle
from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import AdversaryState, CarState

LANE_END = 1000.0  # m from the crossing point, both ways: further than any episode goes


class HighwayIdm:
    """Follows whoever highway-env says is ahead on the lane; keeps nothing from one decision to the next."""

    control_period = 0.05  # s; highway-env's own vehicles decide 15 times a second, which divides no tick of 0.3 s

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Build the scenario's lane; the speed at the start is the one that the car wants. The law draws nothing."""
        if not scenario.road.straight:
            raise UsageError(f"highway_idm knows straight roads only; that of scenario {scenario.name} has curves")
        network = RoadNetwork()
        network.add_lane("south", "north", StraightLane([0, -LANE_END], [0, LANE_END], scenario.road.lane_width))
        self._road, self._desired = Road(network), scenario.car.start_speed

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Return the acceleration (m/s²) that the vehicle asks for."""
        here, there = (car.x, car.y), (adversary.x, adversary.y)
        walking = np.arctan2(adversary.vy, adversary.vx), np.hypot(adversary.vx, adversary.vy)
        driver = IDMVehicle(self._road, here, car.heading, car.speed, None, self._desired, enable_lane_change=False)
        self._road.vehicles = [driver, Vehicle(self._road, there, *walking)]
        driver.act()
        return float(driver.action["acceleration"])
