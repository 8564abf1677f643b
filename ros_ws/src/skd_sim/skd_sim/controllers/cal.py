"""The paper's ML controller: the longitudinal law of Conditional Affordance Learning (Sauer et al. 2018).

Its states are Cruising and Hazard Stop. The probability of a hazard comes from the network in `skd_sim.hazard`, which
sees the car's laser scans; somebody who has just come into view is assumed to run towards the path, until their motion
is seen. It decides 20 times a second, each time on a scan of its own.
"""

from __future__ import annotations

from enum import Enum

import numpy as np

from skd_sim.controllers.pedals import CONTROL_PERIOD, KILOMETRES_PER_HOUR, Pid, pedal_acceleration
from skd_sim.errors import UsageError
from skd_sim.hazard.network import HazardNetwork, shipped_network
from skd_sim.hazard.perception import Perception
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.sensors.scan import Scan
from skd_sim.world.state import AdversaryState, CarState

SPEED_LIMIT = 30.0  # km/h, and from here on all of these are published
HAZARD_PROBABILITY = 0.9
CRUISE_GAINS = (0.06, 0.0258, 0.014)  # per km/h, per km/h·s, per km/h/s
INTEGRAL_LIMIT = 20.0  # km/h·s
MAXIMUM_THROTTLE = 0.8
OVERSPEED = 10.0  # km/h over the limit, above which the car brakes
OVERSPEED_BRAKE = 0.3


class CalState(Enum):
    """What the law does."""

    CRUISING = "cruising"
    HAZARD_STOP = "hazard stop"


class CalController:
    """Cruises at 30 km/h and brakes fully where the network is more than 90 % sure of a hazard.

    Attributes:
        control_period: time between decisions, s.
        state: what it did at the last decision: cruise, or stop for a hazard.
        probability: probability of a hazard at the last decision.
    """

    control_period = CONTROL_PERIOD

    def __init__(self, network: HazardNetwork | None = None) -> None:
        """Make the controller with a network; the shipped one by default."""
        self._network = network or shipped_network()
        self._cruise = Pid(*CRUISE_GAINS, integral_limit=INTEGRAL_LIMIT)

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Forget the last episode; the law draws nothing.

        Raises:
            UsageError: the scenario has no sensor, or its road has curves.
        """
        if scenario.sensor is None:
            raise UsageError(f"controller cal needs a laser scan, and scenario {scenario.name} has no sensor")
        if not scenario.road.straight:
            raise UsageError(
                f"controller cal has learned hazards on straight roads, and the one of scenario {scenario.name} has "
                "curves; leave road.parts out, or take another controller"
            )
        self._deceleration = scenario.car.deceleration
        self._duration = scenario.control_duration
        self._perception = Perception(scenario)
        self._scan: Scan | None = None
        self._cruise.reset()
        self.state = CalState.CRUISING
        self.probability = 0.0

    def sense(self, scan: Scan) -> None:
        """Take the scan of the coming control period."""
        self._scan = scan

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Return the acceleration (m/s²); the adversary's true state is not looked at.

        Raises:
            ValueError: no scan came since the last command.
        """
        if self._scan is None:
            raise ValueError("controller cal was given no scan for this moment: call sense before command")
        perception = self._perception
        perception.update(self._scan, car)
        self._scan = None
        features = np.concatenate([perception.features(car.speed), perception.cautious_features(car.speed)])
        self.probability = float(self._network.probability(features).max(initial=0.0))
        return self._decide(car.speed)

    def _decide(self, speed: float) -> float:
        """Return the acceleration (m/s²) of one decision; the first condition that holds wins."""
        kmh = speed * KILOMETRES_PER_HOUR
        throttle = brake = 0.0
        self.state = CalState.HAZARD_STOP if self.probability > HAZARD_PROBABILITY else CalState.CRUISING
        if self.state == CalState.HAZARD_STOP:
            brake = 1.0
            self._cruise.pause()
        elif kmh > SPEED_LIMIT + OVERSPEED:
            brake = min(1.0, OVERSPEED_BRAKE * kmh / SPEED_LIMIT)
            self._cruise.pause()
        else:
            throttle = min(MAXIMUM_THROTTLE, max(0.0, self._cruise.step(SPEED_LIMIT - kmh, self._duration)))
        return pedal_acceleration(throttle, brake, speed, self._deceleration)
