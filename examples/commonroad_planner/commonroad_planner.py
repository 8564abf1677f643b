"""CommonRoad's reactive planner as the car under test: it samples ways of driving on, and the best free one is driven.

Nothing of the planner is here. In each tick it is told the car's state and where the adversary is predicted to be, and
of its plan that tick is driven. One car plans along the lane only, the other to the side, too.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import commonroad_dc.pycrcc as shapes
import numpy as np
from commonroad.scenario.lanelet import Lanelet
from commonroad.scenario.scenario import Scenario as CommonRoadScenario
from commonroad_clcs.config import CLCSParams
from commonroad_rp.reactive_planner import ReactivePlanner
from commonroad_rp.state import ReactivePlannerState
from commonroad_rp.utility.config import ReactivePlannerConfiguration
from commonroad_rp.utility.utils_coordinate_system import CoordinateSystem
from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.dynamics.basic import Command
from skd_sim.world.state import AdversaryState, CarState

LANE_END = 150.0  # m from the crossing point, both ways: further than any episode and its plans go
REAR_AXLE = 1.4  # m behind the middle of the car
FULL_BRAKE = 8.0  # m/s², where the planner finds no free way; dry asphalt allows it
SLOWEST = 0.06  # m/s; told 0.05 or less, the planner fails while it writes a line of its log
SHORTEST = 0.05  # m of a way that has a curvature
QUIET = "CRITICAL"


class ReactivePlannerCar:
    """Drives what the planner plans, a tick at a time; keeps the acceleration at which the last plan left the car.

    Others than the adversary are not told to it.
    """

    steers = False

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Take measures, lane and wanted speed from the scenario; the planner draws nothing.

        Raises:
            UsageError: the road has curves, or the adversary is no disc.
        """
        if not scenario.road.straight:
            raise UsageError(
                f"commonroad_planner knows straight roads only; that of scenario {scenario.name} has curves"
            )
        if scenario.adversary.radius is None:
            raise UsageError(
                f"commonroad_planner predicts a disc, and the adversary of scenario {scenario.name} is a "
                f"{scenario.adversary.kind}"
            )
        car = scenario.car
        self._measures = car.front, car.rear, car.width, scenario.road.lane_width, self.steers
        self._radius, self._desired, self._tick = scenario.adversary.radius, car.start_speed, scenario.time_step
        self._acceleration, self._angle = 0.0, 0.0

    def command(self, car: CarState, adversary: AdversaryState) -> Command:
        """Return the mean acceleration (m/s²) of the plan's first tick; full braking where there is no free plan.

        One that steers returns that and the mean curvature, 1/m.
        """
        front, rear, *_ = self._measures
        planner, coordinates = _planner(*self._measures)
        behind = REAR_AXLE - 0.5 * (front - rear)
        speed = max(car.speed, SLOWEST)
        start = ReactivePlannerState(
            time_step=0,
            position=np.array([car.x - behind * math.cos(car.heading), car.y - behind * math.sin(car.heading)]),
            orientation=car.heading,
            velocity=speed,
            acceleration=self._acceleration,
            yaw_rate=speed * math.tan(self._angle) / planner.vehicle_params.wheelbase,
            steering_angle=self._angle,
        )
        free = self._predicted(adversary, planner.dt, planner.N)
        planner.reset(initial_state_cart=start, collision_checker=free, coordinate_system=coordinates)
        planner.set_desired_velocity(desired_velocity=self._desired, current_speed=speed)
        plan = planner.plan()
        if plan is None:
            self._acceleration, self._angle = -FULL_BRAKE if car.speed > 0.0 else 0.0, 0.0
            return (-FULL_BRAKE, 0.0) if self.steers else -FULL_BRAKE
        along = plan[1]  # position, speed and acceleration at each step
        steps = round(self._tick / planner.dt)
        self._acceleration = float(along[steps][2])
        acceleration = (float(along[steps][1]) - speed) / self._tick
        if not self.steers:
            return acceleration
        end, way = plan[0].state_list[steps], float(along[steps][0] - along[0][0])
        self._angle = float(end.steering_angle)
        return acceleration, float(end.orientation - car.heading) / way if way > SHORTEST else 0.0

    def _predicted(self, adversary: AdversaryState, step: float, steps: int) -> Any:
        """Return what the plan must not touch: the adversary, who keeps their velocity."""
        moving = shapes.TimeVariantCollisionObject(0)
        for passed in step * np.arange(steps + 1):
            place = adversary.x + passed * adversary.vx, adversary.y + passed * adversary.vy
            moving.append_obstacle(shapes.Circle(self._radius, *map(float, place)))
        free = shapes.CollisionChecker()
        free.add_collision_object(moving)
        return free


class SteeringPlannerCar(ReactivePlannerCar):
    """Plans to the side, too, as far as its lane is free."""

    steers, steers_by = True, "curvature"


@cache
def _planner(
    front: float, rear: float, width: float, lane_width: float, steers: bool
) -> tuple[ReactivePlanner, CoordinateSystem]:
    """Return a planner for a car on the lane, and the lane's coordinates: made once, for it takes long."""
    along = np.arange(-LANE_END, LANE_END + 1.0, 1.0)
    right, centre, left = (
        np.column_stack([np.full_like(along, x), along]) for x in (0.5 * lane_width, 0.0, -0.5 * lane_width)
    )
    road = CommonRoadScenario(0.1)
    road.add_objects(Lanelet(left, centre, right, 1))
    told = ReactivePlannerConfiguration()
    told.debug.multiproc, told.debug.logging_level = False, QUIET
    told.vehicle.length, told.vehicle.width, told.vehicle.wb_rear_axle = front + rear, width, REAR_AXLE
    aside = 0.5 * (lane_width - width) if steers else 0.0
    told.sampling.d_min, told.sampling.d_max = -aside, aside
    told.update(scenario=road)
    coordinates = CoordinateSystem(centre, False, CLCSParams())
    planner = ReactivePlanner(told)
    planner.set_reference_path(coordinate_system=coordinates)
    return planner, coordinates
