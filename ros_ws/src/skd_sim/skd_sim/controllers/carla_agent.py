"""A rule-based car: the longitudinal law of CARLA 0.8's own agent, with its published zones.

It is told where the adversary is, as the agent in CARLA is, and reacts to one on the lane only. Distances and angles
are from the car's reference point and its heading. Source: `agent/modules/obstacle_avoidance.py` and `controllers.py`
of CARLA 0.8 (MIT).
"""

from __future__ import annotations

import math

import numpy as np

from skd_sim.controllers.pedals import KILOMETRES_PER_HOUR, Pid, pedal_acceleration, sub_steps
from skd_sim.scenario.road import road_position
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import to_car_frame
from skd_sim.world.motion import next_speed, travelled
from skd_sim.world.state import AdversaryState, CarState

TARGET_SPEED = 36.0  # km/h
SLOW_DISTANCE = 35.0  # m
SLOW_ANGLE = 0.15  # rad
COASTING = 2.0  # the target speed falls as distance / (COASTING · SLOW_DISTANCE)
STOP_DISTANCE = 12.0  # m
STOP_ANGLE = 0.5  # rad
GAINS = (0.25, 0.20, 0.0)  # per km/h, per km/h·s, per km/h/s
THROTTLE_GAIN = 1.3
MAXIMUM_THROTTLE = 0.75
BRAKE_GAIN = 0.35
BRAKE_THRESHOLD = 0.5  # of the PID's output, below which the car coasts
INTEGRAL_LIMIT = 20.0  # km/h·s; ours, as in CAL: without a bound the integral would outweigh the zones for seconds


def speed_factor(distance: float, angle: float) -> float:
    """Return by what the target speed is multiplied for an adversary at a distance (m) and angle (rad) ahead."""
    if distance < STOP_DISTANCE and abs(angle) < STOP_ANGLE:
        return 0.0
    if distance < SLOW_DISTANCE and abs(angle) < SLOW_ANGLE:
        return distance / (COASTING * SLOW_DISTANCE)
    return 1.0


class CarlaAgent:
    """Slows down for an adversary ahead on the lane and stops for a near one."""

    def __init__(self) -> None:
        """Make the controller."""
        self._pid = Pid(*GAINS, integral_limit=INTEGRAL_LIMIT)

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Forget the last episode; the law draws nothing."""
        self._deceleration = scenario.car.deceleration
        self._half_lane = 0.5 * scenario.road.lane_width
        self._line = scenario.road.line
        self._count, self._duration = sub_steps(scenario.control_duration)
        self._pid.reset()

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Return the mean acceleration (m/s²) over the control period, the adversary taken to stand in it."""
        ahead, left = to_car_frame(adversary.x, adversary.y, car.x, car.y, car.heading)
        speed, total = car.speed, 0.0
        on_lane = abs(road_position(self._line, adversary.x, adversary.y)[1]) <= self._half_lane
        for _ in range(self._count):
            factor = speed_factor(math.hypot(ahead, left), math.atan2(left, ahead)) if on_lane else 1.0
            acceleration = self._decide(speed, factor)
            after = float(next_speed(speed, acceleration, 0.0, self._duration))
            ahead -= float(travelled(speed, after, self._duration))
            speed = after
            total += acceleration
        return total / self._count

    def _decide(self, speed: float, factor: float) -> float:
        excess = speed * KILOMETRES_PER_HOUR - TARGET_SPEED * factor
        output = self._pid.step(excess, self._duration)
        throttle = min(MAXIMUM_THROTTLE, max(0.0, -THROTTLE_GAIN * output))
        brake = min(1.0, BRAKE_GAIN * output) if output > BRAKE_THRESHOLD else 0.0
        return pedal_acceleration(throttle, brake, speed, self._deceleration)
