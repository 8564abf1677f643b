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
        aside: how far beside the line that leads to its impact place it comes, m to the right of the car; it changes
            over to that line. Without it, or with 0, it is on that line all the time.
        change_time: how long the change takes, s.
        change_ends: how long before the two meet the change has ended, s.
    """

    source: str
    speed: Annotated[float, Range(0.0, 60.0, "m/s")]
    impact_places: tuple[Annotated[float, Range(-100.0, 200.0, "% of the car's width")], ...]
    acceleration_distance: Annotated[float, Range(0.0, 20.0, "m")] = 0.0
    headway: Annotated[float, Range(0.0, 20.0, "s")] | None = None
    brake_after: Annotated[float, Range(0.0, 60.0, "s")] | None = None
    deceleration: Annotated[float, Range(0.1, 15.0, "m/s²")] = 4.0
    aside: Annotated[float, Range(-10.0, 10.0, "m")] = 0.0
    change_time: Annotated[float, Range(0.1, 20.0, "s")] | None = None
    change_ends: Annotated[float, Range(0.0, 20.0, "s")] | None = None

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
        changes = (self.change_time, self.change_ends)
        if (self.aside != 0.0) != (None not in changes) or (self.aside == 0.0 and changes != (None, None)):
            raise UsageError(
                f"{where}: protocol.aside, change_time and change_ends say together how the target changes lanes: give "
                "all three, or none of them"
            )
        if self.aside != 0.0 and (self.acceleration_distance or self.headway is not None):
            raise UsageError(
                f"{where}: protocol.aside is for a target that comes along the lane at a steady speed; leave out "
                "acceleration_distance, headway and brake_after"
            )
        if self.change_time is not None and self.change_time * self.speed < 2.0 * abs(self.aside):
            raise UsageError(
                f"{where}: protocol.change_time is too short: at {self.speed:.3g} m/s the target would have to turn "
                f"across the lane to get {abs(self.aside):g} m aside in {self.change_time:g} s"
            )
