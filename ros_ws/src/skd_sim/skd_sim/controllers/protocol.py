"""What SKD asks of a car under test."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np

from skd_sim.encounter.scenario import Scenario
from skd_sim.errors import UsageError
from skd_sim.sensors.scan import Scan
from skd_sim.state import CarState, PedestrianState


@runtime_checkable
class Controller(Protocol):
    """What SKD asks of a controller under test; a class with these two methods is enough."""

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Forget the last episode; draw randomness, if any, from `rng` only."""

    def command(self, car: CarState, pedestrian: PedestrianState) -> float:
        """Return the acceleration (m/s²) for the coming time step."""


@runtime_checkable
class SensingController(Controller, Protocol):
    """A controller that perceives for itself: with this third method it gets the scan of each tick first."""

    def sense(self, scan: Scan) -> None:
        """Take the scan of the tick for which `command` is asked next."""


def require_sensor(controller: Controller, name: str, scenario: Scenario) -> None:
    """Refuse a scenario that cannot give a controller, called `name`, the scans that it needs.

    Raises:
        UsageError: the controller senses, and the scenario has no sensor.
    """
    if isinstance(controller, SensingController) and scenario.sensor is None:
        raise UsageError(
            f"controller {name} needs a laser scan, and scenario {scenario.name} has none: add a section sensor "
            "as in the shipped scenario crossing"
        )
