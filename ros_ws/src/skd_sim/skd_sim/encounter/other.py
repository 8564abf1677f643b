"""The others of a scenario: bystanders, parked and moving vehicles, a car ahead. Each goes its own way, or stands.

They answer to nobody: where they are depends on the time alone. The car under test sees them and can hit them; whoever
stands is in the adversary's way as an obstacle is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from skd_sim.encounter.body import Body
from skd_sim.errors import UsageError
from skd_sim.geometry.heading import on_grid
from skd_sim.inputs.keys import ON_LANE, Range
from skd_sim.state import RoadUserState


@dataclass(frozen=True)
class Waypoint:
    """Where somebody is at a time; between two of them it moves uniformly."""

    also: ClassVar = ON_LANE

    time: Annotated[float, Range(0.0, 600.0, "s since the start")]
    x: Annotated[float, Range(-500.0, 500.0, "m, centre")]
    y: Annotated[float, Range(-500.0, 500.0, "m, centre")]


@dataclass(frozen=True, kw_only=True)
class Other(Body):
    """A disc (`radius`) or a box (`length`, `width`), and its way: one point if it stands, several if it moves.

    After the last point of its way it stands there. A box points the way it moves; until then, to `start_heading`.
    """

    kind: str
    way: tuple[Waypoint, ...]
    radius: Annotated[float, Range(0.05, 1.0, "m")] | None = None
    length: Annotated[float, Range(0.1, 20.0, "m")] | None = None
    width: Annotated[float, Range(0.1, 5.0, "m")] | None = None
    start_heading: Annotated[float, Range(-math.pi, math.pi, "rad, counter-clockwise from East")] | None = None

    @property
    def stands(self) -> bool:
        """Whether it is in one place throughout."""
        return all((point.x, point.y) == (self.way[0].x, self.way[0].y) for point in self.way)

    @property
    def rectangle(self) -> tuple[float, float, float, float, float]:
        """The ground that one that stands takes: centre (m), heading (rad), half length, half width (m)."""
        radius, half_length, half_width = self.shape
        return self.way[0].x, self.way[0].y, self.first_heading, radius or half_length, radius or half_width

    def states(self, ticks: int, time_step: float) -> list[RoadUserState]:
        """Return its states at the ticks 0 … ticks; at the first it comes as fast as it goes on."""
        times = np.array([point.time for point in self.way])
        at = time_step * np.arange(ticks + 1)
        x, y = (np.interp(at, times, [getattr(point, axis) for point in self.way]) for axis in "xy")
        velocities = np.column_stack([np.diff(x), np.diff(y)]) / time_step
        found, heading = [], self.first_heading
        for tick, (vx, vy) in enumerate([velocities[0].tolist(), *velocities.tolist()]):
            heading = float(on_grid(self.heading(heading, vx, vy)))
            found.append(RoadUserState(float(x[tick]), float(y[tick]), vx, vy, heading))
        return found

    def check(self, where: str, section: str) -> None:
        """Refuse a road user without a shape or without a way, or one whose times do not increase.

        Raises:
            UsageError: names the key.
        """
        self.check_body(where, section)
        if not self.way:
            raise UsageError(f"{where}: {section}.way needs at least one point, with time, x and y")
        for index in range(1, len(self.way)):
            before, time = self.way[index - 1].time, self.way[index].time
            if time <= before:
                raise UsageError(
                    f"{where}: {section}.way[{index}].time must be greater than that of the point before it "
                    f"({before:g} s), got {time:g}"
                )
