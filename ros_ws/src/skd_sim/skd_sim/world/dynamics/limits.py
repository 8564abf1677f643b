"""How much of a command a car can follow: its brakes and its tyres have limits.

Brakes of the basic car hold `car.brake_limit` or what the tyres do, whichever is less, but at least `car.deceleration`,
which is what the scenario says that this car can do. The multi-body car has tyres of its own; only its brake is limited
here. Nobody speeds up faster than the tyres hold.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from skd_sim.options.car_dynamics import DYNAMICS
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.dynamics.vehicle import GRAVITY, TYRE

GRIP = TYRE.p_dx1 * GRAVITY
"""m/s² that tyres hold on a dry road: those of the multi-body car, 11.5."""


class CommandLimits(NamedTuple):
    """Least and greatest acceleration that a command can mean, m/s²."""

    least: float
    greatest: float

    def clip(self, acceleration: float) -> float:
        """Return a command within the limits; one that is there already stays as it is, to the bit.

        Raises:
            ValueError: it is not finite.
        """
        if not math.isfinite(acceleration):
            raise ValueError(f"a command must be a finite number (m/s²), got {acceleration}")
        return min(self.greatest, max(self.least, acceleration))


def command_limits(scenario: Scenario) -> CommandLimits:
    """Return the limits of a scenario's car."""
    car, grip = scenario.car, scenario.road.friction * GRIP
    brake = car.brake_limit if DYNAMICS[car.dynamics].tyres else min(car.brake_limit, grip)
    return CommandLimits(-max(car.deceleration, brake), grip)


def clipped_line(counts: Sequence[int], low: float, high: float) -> str:
    """Return what is said of commands that asked more than a car can do.

    Args:
        counts: of such commands, one for each episode that has any.
        low: least acceleration of the car, m/s².
        high: greatest.
    """
    return (
        f"{sum(counts)} commands in {len(counts)} episodes asked more than this car can do; they were clipped to "
        f"{low:.3g} … {high:.3g} m/s²"
    )
