"""A gap follower of F1TENTH as the car under test: it steers to the middle of the gap that reaches furthest.

Nothing of it is here. It sees a laser scan alone, so the edges of the road stand in the scan as walls. From the top of
the checkout:

    git clone https://github.com/f1tenth/f1tenth_planning && git -C f1tenth_planning checkout 74c88d1
    PYTHONPATH=f1tenth_planning scripts/skd assess --controller examples/f1tenth/gap_follower.py:GapFollower \
        --safe-count 2 --kamikaze-count 2 --margin-limit 64 --behaviour none

It plans for a car of 1:10. Where it finds no gap, version 74c88d1 fails with a `TypeError`: then this one brakes.
"""

from __future__ import annotations

import numpy as np
from f1tenth_planning.planning.gap_follower.gap_follower import Gap_follower
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.sensors import Scan
from skd_sim.world.state import AdversaryState, CarState

BEAMS, FIRST, STEP = 1080, -2.35, 0.00435  # of its laser: number, bearing of the first one, rad, and between two, rad
SCALE = 4.0  # of its distances: what it calls 3 m are 12 m
FULL_BRAKE = 8.0  # m/s², where it finds no gap


class GapFollower:
    """Follows the gap at the speed at which it starts."""

    control_period = 0.1  # s

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Take road and speed from the scenario; the follower draws nothing."""
        assert scenario.sensor is not None
        self._follower, self._speed = Gap_follower(), scenario.car.start_speed
        self._edges, self._mount = scenario.road.edges, scenario.sensor.mount_ahead

    def sense(self, scan: Scan) -> None:
        """Take a scan."""
        self._scan = scan

    def command(self, car: CarState, adversary: AdversaryState) -> tuple[float, float]:
        """Return acceleration (m/s²) and steering angle (rad); the adversary is in the scan."""
        bearings = FIRST + STEP * np.arange(BEAMS)
        seen = self._scan.angle_min + self._scan.angle_increment * np.arange(len(self._scan.ranges))
        ranges = np.interp(bearings, seen, np.minimum(self._scan.ranges, self._scan.range_max))
        to_right = np.cos(car.heading + bearings)
        place = car.x + self._mount * np.cos(car.heading)
        left, right = self._edges
        with np.errstate(divide="ignore"):
            walls = np.where(to_right > 0.0, (right - place) / to_right, (-left - place) / to_right)
        try:
            angle, _ = self._follower.plan(np.minimum(ranges, walls) / SCALE)
        except TypeError:
            return -FULL_BRAKE, 0.0
        return min(1.5, max(-FULL_BRAKE, 2.0 * (self._speed - car.speed))), float(angle)
