"""Road users: the adversary, and the others of a scenario: bystanders, parked and moving vehicles, a car ahead.

A body is a disc, or a box that points the way it moves. Where the others are depends on the time alone. The car under
test sees them and can hit them; those that stand are obstacles to the adversary. What is special to a kind stands in
`skd_adversary.crossing.road_users`.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np

from skd_sim.errors import UsageError
from skd_sim.inputs.model import Frozen, OnLane, limits
from skd_sim.options.registry import Registry
from skd_sim.world.state import FloatArray, Pair, RoadUserState, Triple, on_grid, velocity_on_grid

HEIGHT = 1.8
"""How high a road user is drawn, m; nothing but pictures and boxes in messages depends on it."""
_KIND = re.compile(r"[a-z][a-z0-9_]*")


@dataclass(frozen=True, kw_only=True)
class Body(Frozen):
    """What the adversary and the others of a scenario have in common.

    A body is a disc (`radius`), or a box (`length` along the way that it moves, and `width`). `start_heading` is where
    it points before it moves, by default the East. `kind` names what it is, as pedestrian or car.
    """

    kind: str
    radius: Annotated[float, limits(0.05, 1.0, "m")] | None = None
    length: Annotated[float, limits(0.1, 20.0, "m")] | None = None
    width: Annotated[float, limits(0.1, 5.0, "m")] | None = None
    start_heading: Annotated[float, limits(-math.pi, math.pi, "rad, counter-clockwise from East")] | None = None

    def __post_init__(self) -> None:
        """Refuse a body without a shape, with two, or of a kind that is no name."""
        given = [key for key in ("length", "width") if getattr(self, key) is not None]
        if len(given) != (2 if self.radius is None else 0):
            raise UsageError("needs radius, for a disc, or both length and width, for a box")
        if not _KIND.fullmatch(self.kind):
            raise UsageError(
                f"kind must be a name of small letters, digits and _, as pedestrian; got {self.kind!r:.60}"
            )

    @property
    def first_heading(self) -> float:
        """Where a box points before it moves, rad: to the East, unless it says otherwise; a disc points nowhere: 0."""
        return 0.0 if self.start_heading is None or not self.is_box else self.start_heading

    @property
    def is_box(self) -> bool:
        """Whether it is a box; a disc if not."""
        return self.radius is None

    @property
    def reach(self) -> float:
        """Distance from its centre to its furthest point, m: a disc's radius, or half of a box's diagonal."""
        if self.radius is not None:
            return self.radius
        return 0.5 * math.hypot(self.length or 0.0, self.width or 0.0)

    @property
    def core(self) -> float:
        """Radius of the largest disc about its centre that lies within it, m; it cannot pass through an obstacle."""
        return self.radius if self.radius is not None else 0.5 * min(self.length or 0.0, self.width or 0.0)

    @property
    def shape(self) -> Triple:
        """Radius, half length, half width (m), as `world.contact` takes them; of a disc the last two are 0."""
        if self.radius is not None:
            return self.radius, 0.0, 0.0
        return 0.0, 0.5 * (self.length or 0.0), 0.5 * (self.width or 0.0)

    def heading(self, before: float, vx: float, vy: float) -> float:
        """Return where it points (rad) while it moves at a velocity (m/s); a disc points nowhere: 0.

        Args:
            before: heading before, rad; it is kept while the body stands.
            vx: velocity to the East, m/s.
            vy: velocity to the North, m/s.
        """
        if not self.is_box or vx == vy == 0.0:
            return before
        return math.atan2(vy, vx)

    def outline(self, positions: FloatArray) -> FloatArray:
        """Return its outline after a way, as a polygon: k × 2, m.

        Args:
            positions: places of its centre so far, n × 2 with n ≥ 1, m; a box points along its last move.
        """
        return self.outline_at(positions[-1], self.last_heading(positions))

    def outline_at(self, place: FloatArray, heading: float) -> FloatArray:
        """Return its outline at a place (x, y), m, where a box has a heading (rad), as a polygon: k × 2, m."""
        radius, half_length, half_width = self.shape
        if radius > 0.0:
            angles = np.linspace(0.0, 2.0 * math.pi, 33)[:-1]
            return np.asarray(place + radius * np.column_stack([np.cos(angles), np.sin(angles)]))
        ahead, left = (
            np.array([math.cos(heading), math.sin(heading)]),
            np.array([-math.sin(heading), math.cos(heading)]),
        )
        corners = [(1, 1), (-1, 1), (-1, -1), (1, -1)]
        return np.array([place + a * half_length * ahead + b * half_width * left for a, b in corners])

    def last_heading(self, positions: FloatArray) -> float:
        """Return where it points (rad) after a way (n × 2, m)."""
        heading = self.first_heading
        for step in np.diff(positions, axis=0):
            heading = self.heading(heading, float(step[0]), float(step[1]))
        return heading


@dataclass(frozen=True, kw_only=True)
class RoadUser(Body, OnLane):
    """The adversary: its body, its start and its destination.

    Its kind says how it may move; `speed` is the most it can do, m/s. `start_speed` is how fast it comes, along
    `start_heading`; without it, it is seen to stand until its first step. The destination is so far to the right of the
    road's centre line, or in the scenario's section `ending`. A box that stands points where it moved last.
    """

    kind: str = "pedestrian"
    speed: Annotated[float, limits(0.1, 60.0, "m/s")]
    start_x: Annotated[float, limits(-100.0, 100.0, "m")]
    start_y: Annotated[float, limits(-500.0, 500.0, "m")]
    destination_x: Annotated[float, limits(-100.0, 100.0, "m")] | None = None
    distance_noise: Annotated[float, limits(0.001, 100.0, "m, standard deviation")]
    position_noise: Annotated[float, limits(0.001, 100.0, "m per axis, standard deviation")]
    start_speed: Annotated[float, limits(0.0, 60.0, "m/s")] | None = None

    def __post_init__(self) -> None:
        """Refuse an adversary that starts faster than it can move."""
        super().__post_init__()
        if self.start_speed is not None and self.start_speed > self.speed:
            raise UsageError(
                f"start_speed {self.start_speed:g} m/s is more than speed, {self.speed:g} m/s, the most that it can do"
            )

    @property
    def first_velocity(self) -> Pair:
        """Velocity (East, North) that it has when an episode begins, m/s."""
        if not self.start_speed:
            return 0.0, 0.0
        heading = self.start_heading or 0.0
        return self.start_speed * math.cos(heading), self.start_speed * math.sin(heading)

    def first_state(self, x: float, y: float) -> RoadUserState:
        """Return its state when an episode begins with it at (x, y), m."""
        velocity = velocity_on_grid(*self.first_velocity) if self.is_box else self.first_velocity
        return RoadUserState(float(x), float(y), *velocity, float(on_grid(self.first_heading)))


@dataclass(frozen=True)
class Waypoint(OnLane):
    """Where a road user is at a time; between two of them it moves uniformly."""

    time: Annotated[float, limits(0.0, 600.0, "s since the start")]
    x: Annotated[float, limits(-500.0, 500.0, "m, centre")]
    y: Annotated[float, limits(-500.0, 500.0, "m, centre")]


@dataclass(frozen=True, kw_only=True)
class Other(Body):
    """Another road user with its way: one point if it stands, several if it moves.

    After the last point of its way it stands there. A box points the way it moves; until then, to `start_heading`.
    """

    way: tuple[Waypoint, ...]

    def __post_init__(self) -> None:
        """Refuse a road user without a way, or one whose times do not increase."""
        super().__post_init__()
        if not self.way:
            raise UsageError("way needs at least one point, with time, x and y")
        for index in range(1, len(self.way)):
            before, time = self.way[index - 1].time, self.way[index].time
            if time <= before:
                raise UsageError(
                    f"way[{index}].time must be greater than that of the point before it ({before:g} s), got {time:g}"
                )

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


_OWN = ("pedestrian", "runner", "child", "cyclist", "e_scooter", "motorcycle", "car", "van")
ROAD_USERS: Final = Registry(
    "road user", "skd.road_users", {kind: f"skd_adversary.crossing.road_users:{kind.upper()}" for kind in _OWN}
)
"""Of the key `adversary.kind` of a scenario. Others of a scenario may be of these kinds, or of any that has a name."""

CAR: Final = "car"
"""The kind of the car under test."""


def height_of(kind: str) -> float:
    """Return how high a road user of a kind is drawn, m."""
    return float(ROAD_USERS.find(kind).height) if kind in ROAD_USERS else HEIGHT


def called(body: Body, where: str) -> str:
    """Return what another simulator, or a format, calls a road user of a body's kind.

    A kind that has no word for it there is called as the kind car is if its body is a box, else as a pedestrian is.
    """
    word = ROAD_USERS.find(body.kind).names.get(where) if body.kind in ROAD_USERS else None
    return str(word or ROAD_USERS.find(CAR if body.is_box else "pedestrian").names[where])
