"""An inertial measurement unit at the car's reference point, without noise: what sensor_msgs/Imu carries."""

from __future__ import annotations

import math
from typing import NamedTuple

from skd_sim.world.state import CarState

STANDARD_GRAVITY = 9.80665  # m/s²


class Inertia(NamedTuple):
    """What is measured, in the frame of the car (x ahead, y left, z up).

    Attributes:
        heading: heading of the car in the world, counter-clockwise from East, rad (REP 103).
        yaw_rate: rate at which the heading changes, rad/s.
        acceleration: proper acceleration, m/s²: standing still it is gravity's, upwards (REP 145).
    """

    heading: float
    yaw_rate: float
    acceleration: tuple[float, float, float]


class InertialUnit:
    """Tells accelerations from one state to the next, as means over the time in between."""

    def __init__(self) -> None:
        """Begin an episode: at its first state only the heading is known."""
        self._newest: tuple[int, CarState] | None = None
        self._measured = Inertia(0.0, 0.0, (0.0, 0.0, STANDARD_GRAVITY))

    def measure(self, car: CarState, stamp: int) -> Inertia:
        """Return what is measured at a state; for one that was seen already, the same again.

        Args:
            car: true state of the car.
            stamp: time stamp of the state, ns; never before those of earlier calls.
        """
        if self._newest is None:
            self._measured = Inertia(car.heading, 0.0, (0.0, 0.0, STANDARD_GRAVITY))
        elif stamp > self._newest[0]:
            before = self._newest[1]
            seconds = (stamp - self._newest[0]) * 1e-9
            turned = math.remainder(car.heading - before.heading, 2.0 * math.pi)
            yaw_rate = turned / seconds
            # Speed is along the heading, so the acceleration to the side is that of turning.
            ahead, left = (car.speed - before.speed) / seconds, 0.5 * (car.speed + before.speed) * yaw_rate
            self._measured = Inertia(car.heading, yaw_rate, (ahead, left, STANDARD_GRAVITY))
        self._newest = stamp, car
        return self._measured
