"""Section `protocol` of a scenario: what a regulator's test prescribes for its target."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from skd_sim.encounter.unchanging import Unchanging
from skd_sim.errors import UsageError
from skd_sim.inputs.keys import Range


@dataclass(frozen=True, kw_only=True)
class Protocol(Unchanging):
    """The target of a regulator's test; its way starts at the adversary's start and goes along its `start_heading`.

    Attributes:
        source: where the numbers come from.
        speed: of the target, m/s.
        impact_places: where on the car's front the target is when the unbraked car meets it, % of the car's width. They
            count from the side that the target comes from; from the right where it moves along the lane.
        acceleration_distance: on which the target speeds up from standing, m; with 0 it has been moving before.
        headway: how far ahead of the car the target starts, s of the car's way; without it the target starts so that
            the two meet at the crossing line.
        brake_after: how long after the start the target begins to brake until it stands, s; without it never.
        deceleration: with which it brakes, m/s².
    """

    source: str
    speed: Annotated[float, Range(0.0, 60.0, "m/s")]
    impact_places: tuple[Annotated[float, Range(-100.0, 200.0, "% of the car's width")], ...]
    acceleration_distance: Annotated[float, Range(0.0, 20.0, "m")] = 0.0
    headway: Annotated[float, Range(0.0, 20.0, "s")] | None = None
    brake_after: Annotated[float, Range(0.0, 60.0, "s")] | None = None
    deceleration: Annotated[float, Range(0.1, 15.0, "m/s²")] = 4.0

    def check(self, where: str) -> None:
        """Refuse one without an impact place, or that asks for two things at a time.

        Raises:
            UsageError: names the key.
        """
        if not self.impact_places or len(set(self.impact_places)) < len(self.impact_places):
            raise UsageError(f"{where}: protocol.impact_places must be a list of different numbers, at least one")
        if self.acceleration_distance > 0.0 and (self.headway is not None or self.brake_after is not None):
            raise UsageError(
                f"{where}: protocol.acceleration_distance is for a target that starts from standing, headway and "
                "brake_after are for one that drives ahead; leave one out"
            )
