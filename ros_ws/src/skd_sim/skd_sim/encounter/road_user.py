"""The adversary's body: its shape, its kind, where it starts and where it wants to go, how fast it can be."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

from skd_sim.encounter.body import Body
from skd_sim.errors import UsageError
from skd_sim.geometry.heading import on_grid
from skd_sim.inputs.keys import ON_LANE, Range
from skd_sim.state import RoadUserState


@dataclass(frozen=True, kw_only=True)
class RoadUser(Body):
    """The adversary: a disc (`radius`), or a box (`length`, `width`) that points the way it moves; start, destination.

    A box that stands points where it moved last, before its first step to `start_heading`, by default the East. `kind`
    names who it is, and with that how it may move; `speed` is the most it can do, m/s. `start_speed` is how fast it
    comes, along `start_heading`; without it, it is seen to stand until its first step. The destination is so far to the
    right of the road's centre line, or in the scenario's section `ending`.
    """

    also: ClassVar = ON_LANE

    speed: Annotated[float, Range(0.1, 60.0, "m/s")]
    start_x: Annotated[float, Range(-100.0, 100.0, "m")]
    start_y: Annotated[float, Range(-500.0, 500.0, "m")]
    destination_x: Annotated[float, Range(-100.0, 100.0, "m")] | None = None
    distance_noise: Annotated[float, Range(0.001, 100.0, "m, standard deviation")]
    position_noise: Annotated[float, Range(0.001, 100.0, "m per axis, standard deviation")]
    radius: Annotated[float, Range(0.05, 1.0, "m")] | None = None
    length: Annotated[float, Range(0.1, 20.0, "m")] | None = None
    width: Annotated[float, Range(0.1, 5.0, "m")] | None = None
    kind: str = "pedestrian"
    start_heading: Annotated[float, Range(-math.pi, math.pi, "rad, counter-clockwise from East")] | None = None
    start_speed: Annotated[float, Range(0.0, 60.0, "m/s")] | None = None

    @property
    def first_velocity(self) -> tuple[float, float]:
        """Velocity (East, North) that it has when an episode begins, m/s."""
        if not self.start_speed:
            return 0.0, 0.0
        heading = self.start_heading or 0.0
        return self.start_speed * math.cos(heading), self.start_speed * math.sin(heading)

    def first_state(self, x: float, y: float) -> RoadUserState:
        """Return its state when an episode begins with it at (x, y), m."""
        return RoadUserState(float(x), float(y), *self.first_velocity, float(on_grid(self.first_heading)))

    def check(self, where: str) -> None:
        """Refuse an adversary without a shape, with two, or that starts faster than it can move.

        Raises:
            UsageError: names the key under `where`.
        """
        self.check_body(where, "adversary")
        if self.start_speed is not None and self.start_speed > self.speed:
            raise UsageError(
                f"{where}: adversary.start_speed {self.start_speed:g} m/s is more than adversary.speed, "
                f"{self.speed:g} m/s, the most that it can do"
            )
