"""What a scenario is: everything that is fixed about a test, and what follows from that."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Final

import numpy as np

from skd_sim.arrays import FloatArray
from skd_sim.encounter.ending import Ending, Endings, ending_of
from skd_sim.encounter.other import Other
from skd_sim.encounter.protocol.section import Protocol
from skd_sim.encounter.road import Road, right_and_along
from skd_sim.encounter.road_user import RoadUser
from skd_sim.encounter.sections import Car, Collision, Obstacle, Sensor
from skd_sim.encounter.unchanging import Unchanging
from skd_sim.geometry.obstruction import runs_into
from skd_sim.inputs.keys import Range
from skd_sim.state import AdversaryState, RoadUserState

CONTROL_PERIODS: Final = Range(0.001, 2.0, "s")
"""Between two decisions of a car: a shorter time makes an episode longer without end, and no car has it."""


@dataclass(frozen=True)
class Scenario(Unchanging):
    """Everything that is fixed about a test: see `load_scenario`.

    The adversary decides every `time_step`. The car decides every `control_period`, which divides the time step and
    equals it by default. `eta_max` is η_max of the mean deformation, m: as much counts an attempt that fails or that
    needs more.
    """

    name: str
    description: str
    time_step: Annotated[float, Range(0.01, 2.0, "s")]
    horizon: Annotated[float, Range(0.1, 600.0, "s")]
    road: Road
    car: Car
    adversary: RoadUser
    collision: Collision
    eta_max: Annotated[float, Range(0.01, 1000.0, "m")] = 5.0
    control_period: Annotated[float, CONTROL_PERIODS] | None = None
    sensor: Sensor | None = None
    obstacles: tuple[Obstacle, ...] = ()
    others: tuple[Other, ...] = ()
    ending: Endings | None = None
    protocol: Protocol | None = None

    @cached_property
    def ticks(self) -> int:
        """Number of time steps in the horizon."""
        return max(1, round(self.horizon / self.time_step))

    @cached_property
    def control_periods(self) -> int:
        """How often the car decides in a time step."""
        return 1 if self.control_period is None else round(self.time_step / self.control_period)

    @property
    def control_duration(self) -> float:
        """Time between two decisions of the car, s."""
        return self.time_step / self.control_periods

    @property
    def path_edge(self) -> float:
        """Offset from the lane's centre (m) within which the adversary can reach into the strip that the car sweeps."""
        return self.car.half_width + self.adversary.reach

    @cached_property
    def rectangles(self) -> FloatArray:
        """Rectangles of all that stands, n × 5: the obstacles, then the others that stand.

        A row is centre (m), heading (rad), half length, half width (m); a disc takes the square about it.
        """
        rows = [(one.x, one.y, one.heading, 0.5 * one.length, 0.5 * one.width) for one in self.obstacles]
        rows += [one.rectangle for one in self.others if one.stands]
        return np.array(rows, dtype=np.float64).reshape(len(rows), 5)

    @cached_property
    def _tracks(self) -> list[list[RoadUserState]]:
        """States of each of the others at every tick of the horizon, and at one more."""
        return [other.states(self.ticks + 1, self.time_step) for other in self.others]

    def others_at(self, tick: int, period: int = 0) -> tuple[RoadUserState, ...]:
        """Return the states of the others at a control period's beginning; after the horizon as at its end."""
        if not self.others:
            return ()
        tick = min(tick, self.ticks)
        if period == 0:
            return tuple(track[tick] for track in self._tracks)
        passed = self.time_step * period / self.control_periods
        return tuple(track[tick].moved(track[tick + 1], passed) for track in self._tracks)

    def others_after(self, elapsed: float) -> tuple[RoadUserState, ...]:
        """Return the states of the others so many seconds after the start."""
        tick = max(0, int(elapsed / self.time_step + 1e-6))
        return self.others_at(tick, round((elapsed - tick * self.time_step) / self.control_duration))

    def ran_into_obstacle(self, adversary: AdversaryState) -> bool:
        """Return whether the adversary touched an obstacle in the time step that ended in this state."""
        if not len(self.rectangles):
            return False
        x, y, vx, vy, _ = adversary
        before = x - self.time_step * vx, y - self.time_step * vy
        return bool(runs_into(self.rectangles, *before, x, y, self.adversary.core))

    @cached_property
    def end(self) -> Ending:
        """When an episode of this scenario is over, by path coordinates."""
        here = np.array([[self.adversary.start_x, self.adversary.start_y]])
        start = float(right_and_along(self.road.line, here)[0, 0])
        return ending_of(self.road.line, self.path_edge, start, self.adversary.destination_x, self.ending)

    def as_dict(self) -> dict[str, Any]:
        """Return the scenario as plain data; `scenario_from_dict` is the inverse."""
        return _given(dataclasses.asdict(self))


def _given(data: dict[str, Any]) -> dict[str, Any]:
    """Return nested data without what was left out."""
    given: dict[str, Any] = {}
    for key, value in data.items():
        if isinstance(value, dict):
            given[key] = _given(value)
        elif isinstance(value, tuple) and value:
            given[key] = tuple(_given(item) if isinstance(item, dict) else item for item in value)
        elif value not in (None, ()):
            given[key] = value
    return given
