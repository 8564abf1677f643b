"""MetaDrive's pedals, measured: from an acceleration to a pedal and back; and whether MetaDrive is installed.

MetaDrive has one number for both pedals: from 0 to 1 the throttle, from 0 to −1 the brake. Its wheels brake by
impulses, so a longer step of the physics brakes less. With no pedal at all its cars roll against a small brake of
their own; under the slightest throttle or brake they do not. Imports nothing of MetaDrive.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np

from skd_sim.errors import UsageError
from skd_sim.start import installing
from skd_sim.world.dynamics.basic import CommandLimits

METADRIVE: Final = "metadrive"
"""What the simulator is called on the command line."""
VERSION: Final = "0.4.3"
_DISTRIBUTION: Final = "metadrive-simulator"


def require_metadrive() -> None:
    """Refuse to go on without MetaDrive.

    Raises:
        UsageError: it is not installed, or in another version; says how it is installed.
    """
    try:
        found = importlib.metadata.version(_DISTRIBUTION)
    except importlib.metadata.PackageNotFoundError:
        found = ""
    if found != VERSION or importlib.util.find_spec("metadrive") is None:
        there = f"version {found} is installed" if found else "it is not installed"
        raise UsageError(
            f"simulator {METADRIVE} needs MetaDrive {VERSION}, and {there}: {installing('metadrive')} (Python 3.11)"
        )


FULL_SPEED: Final = 25.0 / 3.0
"""Speed from which stops are measured at least, m/s: 30 km/h."""
LEAST_SPEED: Final = 0.5
"""Speed down to which a stop is measured, m/s: below it MetaDrive's cars tremble."""
_TOUCH = 1e-6  # of a pedal: the car rolls freely


class MeasuredPedal(NamedTuple):
    """A pedal's position in [0, 1], and the acceleration that it gave, m/s²."""

    pedal: float
    acceleration: float


@dataclass(frozen=True)
class Pedals:
    """The pedals of one car.

    Attributes:
        BRAKES: positions of the brake that are measured.
        THROTTLES: positions of the throttle that are measured.
        brakes: what each position of the brake did in a stop.
        throttles: what each position of the throttle did.
        coasting: acceleration without any pedal, m/s².
    """

    BRAKES: ClassVar = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
    THROTTLES: ClassVar = (0.25, 0.5, 0.75, 1.0)

    brakes: tuple[MeasuredPedal, ...]
    throttles: tuple[MeasuredPedal, ...]
    coasting: float

    @cached_property
    def limits(self) -> CommandLimits:
        """Least and greatest acceleration that they give, m/s²."""
        return CommandLimits(-self._brake[1][-1], self._throttle[1][-1])

    def pedal(self, acceleration: float) -> float:
        """Return MetaDrive's number, in [−1, 1] and never 0, for an acceleration within the limits (m/s²)."""
        if acceleration <= 0.0:
            return -max(_TOUCH, float(np.interp(-acceleration, *self._brake[::-1])))
        return max(_TOUCH, float(np.interp(acceleration, *self._throttle[::-1])))

    def acceleration(self, pedal: float) -> float:
        """Return the acceleration (m/s²) for MetaDrive's number, in [−1, 1]; the inverse of `pedal`."""
        if pedal == 0.0:
            return self.coasting
        return -float(np.interp(-pedal, *self._brake)) if pedal < 0.0 else float(np.interp(pedal, *self._throttle))

    @cached_property
    def _brake(self) -> tuple[list[float], list[float]]:
        return _line(self.brakes)

    @cached_property
    def _throttle(self) -> tuple[list[float], list[float]]:
        return _line(self.throttles)

    def as_dict(self) -> dict[str, Any]:
        """Return them as plain data, as results keep them: pairs of pedal and acceleration, m/s²."""
        return {
            "brake": [list(one) for one in self.brakes],
            "throttle": [list(one) for one in self.throttles],
            "coasting": self.coasting,
        }


def _line(points: tuple[MeasuredPedal, ...]) -> tuple[list[float], list[float]]:
    """Return a line that rises from (0, 0): positions of a pedal, and the size of the acceleration there, m/s².

    Where more pedal did less, it stays level.
    """
    sizes = np.maximum.accumulate([0.0, *(abs(one.acceleration) for one in points)])
    return [0.0, *(one.pedal for one in points)], sizes.tolist()
