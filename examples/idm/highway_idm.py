"""highway-env's driver as the car under test: its own vehicle on its own road decides.

Nothing of the laws is here. `IDMVehicle.act` looks for who leads, asks `IDMVehicle.acceleration` and bounds the answer;
where it may, it changes lanes by MOBIL and steers.
"""

from __future__ import annotations

import math

import numpy as np
from highway_env.road.lane import StraightLane
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle
from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import AdversaryState, CarState, Scene

LANE_END = 1000.0  # m from the crossing point, both ways: further than any episode goes


def road_with(scenario: Scenario, numbers: list[int]) -> Road:
    """Return highway-env's road with some lanes of the scenario, all of which lead North."""
    road, network = scenario.road, RoadNetwork()
    if not road.straight:
        raise UsageError(f"highway_idm knows straight roads only; that of scenario {scenario.name} has curves")
    for number in numbers:
        x = road.offset(number)
        network.add_lane("south", "north", StraightLane([x, -LANE_END], [x, LANE_END], road.width(number)))
    return Road(network)


def vehicle(road: Road, user: AdversaryState) -> Vehicle:
    """Return a road user as highway-env's driver sees it."""
    return Vehicle(road, (user.x, user.y), np.arctan2(user.vy, user.vx), np.hypot(user.vx, user.vy))


class HighwayIdm:
    """Follows whoever highway-env says is ahead on the lane; keeps nothing from one decision to the next."""

    control_period = 0.05  # s; highway-env's own vehicles decide 15 times a second, which divides no tick of 0.3 s

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Build the scenario's lane; the speed at the start is the one that the car wants. The law draws nothing."""
        self._road, self._desired = road_with(scenario, [0]), scenario.car.start_speed

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Return the acceleration (m/s²) that the vehicle asks for."""
        here = car.x, car.y
        driver = IDMVehicle(self._road, here, car.heading, car.speed, None, self._desired, enable_lane_change=False)
        self._road.vehicles = [driver, vehicle(self._road, adversary)]
        driver.act()
        return float(driver.action["acceleration"])


class HighwayMobil:
    """Steers as well, and changes lanes by MOBIL, which takes every lane for one of its own direction."""

    control_period = HighwayIdm.control_period
    steers_by = "curvature"

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Build the road; the driver, who keeps the lane that it wants and the time since it thought of it, is new."""
        beside = [number for number, lane in sorted(scenario.road.every_lane.items()) if lane.beside]
        self._road, self._desired = road_with(scenario, beside), scenario.car.start_speed
        self._driver: IDMVehicle | None = None

    def command(self, car: CarState, scene: Scene) -> tuple[float, float]:
        """Return the acceleration (m/s²) and the curvature (1/m) that the vehicle asks for."""
        here = np.array([car.x, car.y])
        if self._driver is None:
            self._driver = IDMVehicle(self._road, here, car.heading, car.speed, None, self._desired)
        driver = self._driver
        driver.position, driver.heading, driver.speed = here, car.heading, car.speed
        driver.on_state_update()
        self._road.vehicles = [driver, *(vehicle(self._road, user) for user in (scene.adversary, *scene.others))]
        driver.act()
        driver.timer += self.control_period
        return float(driver.action["acceleration"]), math.tan(driver.action["steering"]) / driver.LENGTH
