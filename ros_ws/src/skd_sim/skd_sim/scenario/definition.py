"""What a scenario is: everything that is fixed about a test, and what follows from that."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.inputs.model import Frozen, OneOf, OnLane, YesNo, limits
from skd_sim.options.car_dynamics import BASIC, DYNAMICS
from skd_sim.scenario.ending import Ending, Endings, ending_of
from skd_sim.scenario.road import Road, right_and_along
from skd_sim.scenario.road_user import Other, RoadUser
from skd_sim.world.motion import braking_distance
from skd_sim.world.obstruction import runs_into
from skd_sim.world.state import AdversaryState, RoadUserState

CONTROL_PERIODS = (0.001, 2.0)
"""Least and greatest time between two decisions of a car, s."""


@dataclass(frozen=True)
class Car(Frozen):
    """Footprint, dynamics and start of the car under test.

    `start_gap` is from the front bumper to the crossing line; an episode adds a draw from [0, start_gap_range).
    With `meet_safe_trajectory` the gap is instead the distance that the unbraked car drives until φ enters its path.
    `dynamics` and the brake's keys say how the car moves (world/dynamics); the basic car has no use for the latter.
    `mass` is for simulators whose car has one (MetaDrive); by default it has its own.
    """

    front: Annotated[float, limits(0.1, 10.0, "m ahead of the reference point")]
    rear: Annotated[float, limits(0.1, 20.0, "m behind the reference point")]
    width: Annotated[float, limits(0.2, 5.0, "m")]
    start_speed: Annotated[float, limits(0.0, 60.0, "m/s")]
    start_gap: Annotated[float, limits(0.0, 500.0, "m")]
    start_gap_range: Annotated[float, limits(0.0, 50.0, "m")]
    meet_safe_trajectory: YesNo
    deceleration: Annotated[float, limits(0.1, 15.0, "m/s²")]
    speed_noise: Annotated[float, limits(0.0, 0.5, "relative")]
    acceleration_noise: Annotated[float, limits(0.0, 0.9, "relative")]
    dynamics: Annotated[str, OneOf(DYNAMICS)] = BASIC
    brake_delay: Annotated[float, limits(0.0, 1.0, "s")] = 0.1
    brake_rate: Annotated[float, limits(1.0, 1000.0, "m/s³")] = 50.0
    brake_limit: Annotated[float, limits(0.1, 30.0, "m/s²")] = 15.0
    antilock: YesNo = True
    mass: Annotated[float, limits(50.0, 50000.0, "kg")] | None = None

    @property
    def half_width(self) -> float:
        """Half of the car's width, m."""
        return 0.5 * self.width

    @property
    def safe_distance(self) -> float:
        """κ: distance to stop from the start speed at full deceleration, m (paper, "The Cars")."""
        return braking_distance(self.start_speed, self.deceleration)


@dataclass(frozen=True)
class Collision(Frozen):
    """What counts as a collision, and which collisions count as a hit by the moving car.

    A touch at `minimum_impact_speed` or more of the car's own speed is a collision and ends the episode. It is a *hit*
    at `hit_speed` or more, by default 2 km/h, Euro NCAP's tolerance of impact speeds (Crash Avoidance Frontal v1.1):
    margin, risk and the deviation that ranks count hits, the paper's SKD any collision.
    """

    minimum_impact_speed: Annotated[float, limits(0.0, 60.0, "m/s")]
    hit_speed: Annotated[float, limits(0.0, 60.0, "m/s")] = 0.556

    def is_hit(self, impact_speed: float) -> bool:
        """Tell whether a collision at this speed of the car (m/s) is a hit."""
        return impact_speed >= self.hit_speed


@dataclass(frozen=True)
class Sensor(Frozen):
    """Planar laser scanner on the car's axis, looking ahead; beams are spread evenly over the field of view."""

    mount_ahead: Annotated[float, limits(-20.0, 20.0, "m ahead of the reference point")]
    beams: Annotated[int, limits(2, 4096, "beams")]
    field_of_view: Annotated[float, limits(0.01, 2 * math.pi, "rad")]
    maximum_range: Annotated[float, limits(1.0, 300.0, "m")]
    range_noise: Annotated[float, limits(0.0, 1.0, "m, standard deviation")]
    dropout: Annotated[float, limits(0.0, 0.9, "probability per beam")]


@dataclass(frozen=True)
class Obstacle(OnLane):
    """A parked rectangle: it hides what is behind it, and nobody walks through it.

    It stands clear of the strip that the car sweeps, so the car never meets it. With `hides: false` it is as low as a
    guard rail: nobody walks through it, and the car's laser sees over it.
    """

    x: Annotated[float, limits(-100.0, 100.0, "m, centre")]
    y: Annotated[float, limits(-500.0, 500.0, "m, centre")]
    heading: Annotated[float, limits(-math.pi, math.pi, "rad, of its length")]
    length: Annotated[float, limits(0.1, 30.0, "m")]
    width: Annotated[float, limits(0.1, 30.0, "m")]
    hides: YesNo | None = None

    @property
    def corners(self) -> FloatArray:
        """Corners of the rectangle, 4 × 2, m."""
        ahead = 0.5 * self.length * np.array([math.cos(self.heading), math.sin(self.heading)])
        left = 0.5 * self.width * np.array([-math.sin(self.heading), math.cos(self.heading)])
        corners = [ahead + left, left - ahead, -ahead - left, ahead - left]
        return np.asarray(np.array([self.x, self.y]) + np.array(corners))


@dataclass(frozen=True, kw_only=True)
class Protocol(Frozen):
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
    speed: Annotated[float, limits(0.0, 60.0, "m/s")]
    impact_places: tuple[Annotated[float, limits(-100.0, 200.0, "% of the car's width")], ...]
    acceleration_distance: Annotated[float, limits(0.0, 20.0, "m")] = 0.0
    headway: Annotated[float, limits(0.0, 20.0, "s")] | None = None
    brake_after: Annotated[float, limits(0.0, 60.0, "s")] | None = None
    deceleration: Annotated[float, limits(0.1, 15.0, "m/s²")] = 4.0
    aside: Annotated[float, limits(-10.0, 10.0, "m")] = 0.0
    change_time: Annotated[float, limits(0.1, 20.0, "s")] | None = None
    change_ends: Annotated[float, limits(0.0, 20.0, "s")] | None = None

    def __post_init__(self) -> None:
        """Refuse one without an impact place, or that asks for two things at a time."""
        if not self.impact_places or len(set(self.impact_places)) < len(self.impact_places):
            raise UsageError("impact_places must be a list of different numbers, at least one")
        if self.acceleration_distance > 0.0 and (self.headway is not None or self.brake_after is not None):
            raise UsageError(
                "acceleration_distance is for a target that starts from standing, headway and brake_after are for one "
                "that drives ahead; leave one out"
            )
        changes = (self.change_time, self.change_ends)
        if (self.aside != 0.0) != (None not in changes) or (self.aside == 0.0 and changes != (None, None)):
            raise UsageError(
                "aside, change_time and change_ends say together how the target changes lanes: give all three, or none"
            )
        if self.aside != 0.0 and (self.acceleration_distance or self.headway is not None):
            raise UsageError(
                "aside is for a target that comes along the lane at a steady speed; leave out acceleration_distance, "
                "headway and brake_after"
            )
        if self.change_time is not None and self.change_time * self.speed < 2.0 * abs(self.aside):
            raise UsageError(
                f"change_time is too short: at {self.speed:.3g} m/s the target would have to turn across the lane to "
                f"get {abs(self.aside):g} m aside in {self.change_time:g} s"
            )


@dataclass(frozen=True)
class Scenario(Frozen):
    """Everything that is fixed about a test: see `load_scenario`.

    The adversary decides every `time_step`. The car decides every `control_period`, which divides the time step and
    equals it by default. `eta_max` is η_max of the mean deviation, m: as much counts an attempt that fails or that
    needs more.
    """

    name: str
    description: str
    time_step: Annotated[float, limits(0.01, 2.0, "s")]
    horizon: Annotated[float, limits(0.1, 600.0, "s")]
    road: Road
    car: Car
    adversary: RoadUser
    collision: Collision
    eta_max: Annotated[float, limits(0.01, 1000.0, "m")] = 5.0
    control_period: Annotated[float, limits(*CONTROL_PERIODS, "s")] | None = None
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
