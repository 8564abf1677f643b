"""Scenario: everything that is fixed about a test, checked, and what follows from it.

Every key is known and in range, and required unless it has a default. A mistake is one line that names file, key and
what would be right.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from skd_sim.errors import UsageError
from skd_sim.inputs.model import Frozen, OneOf, OnLane, YesNo, limits, plain, read_model
from skd_sim.options.car_and_adversary import BASIC, DYNAMICS
from skd_sim.scenario.ending import NOWHERE, Ending, Endings, ending_of
from skd_sim.scenario.lanes import with_absolute_keys, without_lanes
from skd_sim.scenario.road import HEADING_NORTH, ONCOMING, Road, right_and_along, road_pose
from skd_sim.scenario.road_user import CAR, Other, RoadUser
from skd_sim.scenario.scenario_file import scenario_data
from skd_sim.world.contact import clearance, rectangle_distance, runs_into, sweep, to_car_frame
from skd_sim.world.state import AdversaryState, FloatArray, Pair, RoadUserState, Trajectory, Triple, braking_distance

CONTROL_PERIODS = (0.001, 2.0)
"""Least and greatest time between two decisions of a car, s."""
FREE, OCCUPIED = "free", "occupied"
"""States of an oncoming lane."""


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
    def footprint(self) -> Triple:
        """How far it reaches ahead of its reference point, behind it and to each side, m."""
        return self.front, self.rear, self.half_width

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
class LaserSensor(Frozen):
    """Planar laser scanner on the car's axis, looking ahead; beams are spread evenly over the field of view.

    The first beam is at the right end of the field of view, or at `first_bearing`: 0 is straight ahead.
    """

    mount_ahead: Annotated[float, limits(-20.0, 20.0, "m ahead of the reference point")]
    beams: Annotated[int, limits(2, 4096, "beams")]
    field_of_view: Annotated[float, limits(0.01, 2 * math.pi, "rad")]
    maximum_range: Annotated[float, limits(1.0, 300.0, "m")]
    range_noise: Annotated[float, limits(0.0, 1.0, "m, standard deviation")]
    dropout: Annotated[float, limits(0.0, 0.9, "probability per beam")]
    first_bearing: Annotated[float, limits(-2 * math.pi, 2 * math.pi, "rad, to the left")] | None = None


@dataclass(frozen=True)
class Obstacle(OnLane):
    """A parked rectangle: it hides what is behind it, and blocks the adversary.

    It stands clear of the strip that the car sweeps, so the car never meets it. With `hides: false` it is as low as a
    guard rail: it blocks the adversary, and the car's laser sees over it.
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
    impact_places: tuple[Annotated[float, limits(-300.0, 300.0, "% of the car's width")], ...]
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
    equals it by default. `eta_max` is η_max of the mean deviation, m: as much counts a trial that fails or that
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
    sensor: LaserSensor | None = None
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
        return self._ending(self.path_edge)

    @cached_property
    def end_if_steered(self) -> Ending:
        """The same where the car may be anywhere on the road."""
        return self._ending(max(self.path_edge, max(self.road.edges) + self.adversary.reach))

    @cached_property
    def oncoming_lanes(self) -> tuple[int, ...]:
        """The numbers of the lanes of oncoming traffic, the nearest first."""
        found = [number for number, lane in self.road.every_lane.items() if lane.direction == ONCOMING]
        return tuple(sorted(found, key=abs))

    def comes(self, other: Other) -> bool:
        """Return whether one of the others drives along an oncoming lane."""
        return not other.stands and self._on_oncoming_lane([(point.x, point.y) for point in other.way])

    def _on_oncoming_lane(self, places: list[Pair]) -> bool:
        across = right_and_along(self.road.line, np.array(places))[:, 0]
        lanes = [(self.road.offset(number), 0.5 * self.road.width(number)) for number in self.oncoming_lanes]
        return any(bool((np.abs(across - middle) < half).all()) for middle, half in lanes)

    @property
    def oncoming_lane(self) -> str:
        """State of the oncoming lane, `free` or `occupied`; empty without one, or where the adversary drives on it."""
        one = self.adversary
        if not self.oncoming_lanes or (one.is_box and self._on_oncoming_lane([(one.start_x, one.start_y)])):
            return ""
        return OCCUPIED if any(map(self.comes, self.others)) else FREE

    def _ending(self, edge: float) -> Ending:
        here = np.array([[self.adversary.start_x, self.adversary.start_y]])
        start = float(right_and_along(self.road.line, here)[0, 0])
        return ending_of(self.road.line, edge, start, self.adversary.destination_x, self.ending)

    def as_dict(self) -> dict[str, Any]:
        """Return the scenario as plain data; `scenario_from_dict` is the inverse."""
        return plain(self)


Shape = Triple

_FURTHEST = 400.0  # m from the crossing line, which a car on an oncoming lane reaches
_OBSTACLE_SPACING = 0.1  # m between the places of an obstacle that are held against the car's path
_START_SPACING = 0.05  # m between the places at which a car on a curved road is looked at before it starts


def check_scenario(scenario: Scenario, where: str) -> None:
    """Refuse a scenario whose sections do not go together.

    Args:
        scenario: each section of it is valid by itself.
        where: file or other origin, for messages.

    Raises:
        UsageError: names the keys.
    """
    if scenario.horizon < scenario.time_step:
        raise UsageError(f"{where}: horizon must be at least time_step ({scenario.time_step:g} s)")
    check_control_period(scenario, where)
    _check_destination(scenario, where)
    _check_dynamics(scenario, where)
    _check_obstacles(scenario, where)
    if not scenario.car.meet_safe_trajectory:
        _check_others(scenario, where)
        _check_start(scenario, where)


def _check_dynamics(scenario: Scenario, where: str) -> None:
    """Refuse a road that the car's dynamics know nothing of."""
    name, road, kind = scenario.car.dynamics, scenario.road, DYNAMICS[scenario.car.dynamics]
    for key, wrong, able, why in (
        ("friction", road.friction != 1.0 and not kind.tyres, "tyres", f"{road.friction:g} has no effect on"),
        ("parts", not road.straight and not kind.steers, "steers", "has curves, which cannot be followed by"),
    ):
        if wrong:
            others = " or ".join(one for one, other in DYNAMICS.items() if getattr(other, able))
            raise UsageError(
                f"{where}: road.{key} {why} car.dynamics {name}; set car.dynamics to {others}, or leave it out"
            )


def _check_obstacles(scenario: Scenario, where: str) -> None:
    """Refuse obstacles in the car's path, which it does not steer around, and those where the adversary starts."""
    needed, adversary = scenario.car.half_width, scenario.adversary
    for index, (row, obstacle) in enumerate(zip(scenario.rectangles, scenario.obstacles, strict=False)):
        apart = float(np.abs(right_and_along(scenario.road.line, _filled(obstacle))[:, 0]).min())
        if apart <= needed:
            raise UsageError(
                f"{where}: obstacles[{index}] stands in the car's path: it comes within {apart:.2f} m of the lane's "
                f"centre line, and the car, which does not steer around it, takes {needed:g} m to each side; move it "
                "aside"
            )
        near = clearance(row[None], adversary.start_x, adversary.start_y)
        if not scenario.car.meet_safe_trajectory and near <= adversary.core:
            raise UsageError(
                f"{where}: the adversary starts in obstacles[{index}] (centre to its edge {near:.2f} m, must exceed "
                f"{adversary.core:g} m); move it, or adversary.start_x, start_y"
            )


def _filled(obstacle: Obstacle) -> FloatArray:
    """Return points all over an obstacle, edges and corners included, n × 2, m."""
    first, second, third, _ = obstacle.corners
    along, across = (
        np.linspace(0.0, 1.0, 2 + int(size / _OBSTACLE_SPACING))[:, None] for size in (obstacle.length, obstacle.width)
    )
    edge = first + along * (second - first)
    return np.asarray((edge[:, None] + across[None] * (third - second)).reshape(-1, 2))


def _check_destination(scenario: Scenario, where: str) -> None:
    """Refuse an adversary that has no destination, or that starts at its destination."""
    adversary, endings = scenario.adversary, scenario.ending
    arrived = None if endings is None else endings.arrived
    if adversary.destination_x is None and arrived is None:
        raise UsageError(f"{where}: missing key adversary.destination_x (or a section ending with arrived)")
    if adversary.destination_x is not None and arrived is not None:
        raise UsageError(
            f"{where}: adversary.destination_x and ending.arrived both say where the adversary has arrived; leave one "
            "out"
        )
    if adversary.destination_x == adversary.start_x:
        raise UsageError(f"{where}: adversary.destination_x must differ from adversary.start_x")
    if arrived is not None and arrived.bounds == NOWHERE:
        raise UsageError(f"{where}: ending.arrived needs right_of, left_of, ahead_of or behind (m)")


def _check_others(scenario: Scenario, where: str) -> None:
    """Refuse others that are where the car or the adversary starts."""
    adversary = scenario.adversary
    for index, other in enumerate(scenario.others):
        section = f"others[{index}]"
        first = scenario.others_at(0)[index]
        starts = _start_poses(scenario, scenario.car.start_gap)  # wherever in its start range the car starts
        if any(_touches(pose, scenario.car.footprint, first, other.shape) for pose in starts):
            raise UsageError(f"{where}: {section} is where the car starts; move it, or change car.start_gap")
        start = RoadUserState(adversary.start_x, adversary.start_y, 0.0, 0.0, adversary.first_heading)
        if _overlap(first, other.shape, start, adversary.shape):
            raise UsageError(
                f"{where}: {section} is where the adversary starts; move it, or adversary.start_x, start_y"
            )


def _overlap(one: RoadUserState, shape: Shape, other: RoadUserState, other_shape: Shape) -> bool:
    """Return whether two bodies are in the same place; shapes as `Body.shape`."""
    if shape[0] > 0.0 and other_shape[0] > 0.0:
        return math.hypot(one.x - other.x, one.y - other.y) <= shape[0] + other_shape[0]
    if shape[0] > 0.0:
        return _overlap(other, other_shape, one, shape)
    return _touches((one.x, one.y, one.heading), (shape[1], shape[1], shape[2]), other, other_shape)


def _touches(pose: Triple, footprint: Triple, body: RoadUserState, shape: Shape) -> bool:
    """Return whether a rectangle (front, rear and half width from its pose, m) and a body are in the same place."""
    stands = np.array([(*pose, 0.0), (*pose, 0.0)])
    place = (body.x, body.y)
    share, _ = sweep(stands, place, place, (0.0, 0.0), body.heading, footprint, shape, 1.0, 0, 1)
    return bool(share <= 1.0)


def _start_poses(scenario: Scenario, gap: float) -> Iterator[Triple]:
    """Yield poses (m, rad) all over the car's start range, whose least gap to the crossing line is `gap`, m."""
    car, nearest = scenario.car, -gap - scenario.car.front
    for place in np.linspace(nearest - car.start_gap_range, nearest, 2 + int(car.start_gap_range / _START_SPACING)):
        yield road_pose(scenario.road.line, place)


def check_trajectory(scenario: Scenario, trajectory: Trajectory) -> None:
    """Refuse a way of the adversary that leads through an obstacle.

    Raises:
        UsageError: it does; says through which, and when.
    """
    points, core = trajectory.positions, scenario.adversary.core
    names = [f"obstacles[{index}]" for index in range(len(scenario.obstacles))]
    names += [f"others[{index}]" for index, other in enumerate(scenario.others) if other.stands]
    for name, row in zip(names, scenario.rectangles, strict=True):
        for tick in range(len(points)):
            before = points[max(0, tick - 1)]
            if runs_into(row[None], before[0], before[1], points[tick, 0], points[tick, 1], core):
                raise UsageError(
                    f"safe trajectory {trajectory.name!r} runs into {name} of scenario {scenario.name} at "
                    f"{tick * trajectory.time_step:.3g} s, at ({points[tick, 0]:.3g}, {points[tick, 1]:.3g}) m; a safe "
                    "trajectory leads around obstacles"
                )


def check_control_period(scenario: Scenario, where: str) -> None:
    """Refuse a control period that does not divide the time step."""
    period, step = scenario.control_period, scenario.time_step
    if period is not None and (
        scenario.control_periods < 1 or abs(scenario.control_periods * period - step) > 1e-9 * step
    ):
        count = max(1, scenario.control_periods)
        raise UsageError(
            f"{where}: control_period {period:g} s must divide time_step {step:g} s; {step / count:.6g} s does"
        )


def start_clearance(scenario: Scenario, x: float, y: float, gap: float) -> float:
    """Return the least distance (m) from a point (m) to the car's footprint, wherever in its start range it starts.

    Args:
        scenario: scenario whose road and car count.
        x: place of the point to the East, m.
        y: place of the point to the North, m.
        gap: least distance from the front bumper to the crossing line, m.
    """
    car = scenario.car
    if scenario.road.straight:
        ahead, left = to_car_frame(x, y, 0.0, -gap - car.front, HEADING_NORTH)
        return float(rectangle_distance(ahead, left, car.front, car.rear + car.start_gap_range, car.half_width))
    seen = [to_car_frame(x, y, *pose) for pose in _start_poses(scenario, gap)]
    return min(float(rectangle_distance(*here, car.front, car.rear, car.half_width)) for here in seen)


def _check_start(scenario: Scenario, where: str) -> None:
    """Refuse a start at which the car, anywhere in its start range, overlaps the adversary."""
    adversary = scenario.adversary
    gap = start_clearance(scenario, adversary.start_x, adversary.start_y, scenario.car.start_gap)
    if gap <= adversary.reach:
        what = "half of the adversary's diagonal," if adversary.is_box else "adversary.radius"
        raise UsageError(
            f"{where}: the car overlaps the adversary at the start (footprint to centre {gap:.2f} m, must exceed "
            f"{what} {adversary.reach:g} m); increase car.start_gap or move adversary.start_x, start_y"
        )


def scenario_from_dict(data: Any, where: str = "scenario") -> Scenario:
    """Build and check a scenario from plain data.

    Args:
        data: nested mapping with the keys of `Scenario`; places may be given by lanes, and the car's start by time
            (`skd_sim.scenario.scenario_file`).
        where: file or other origin, for messages.

    Raises:
        UsageError: a key is missing, unknown or out of range, or the car overlaps the adversary at the start.
    """
    scenario = read_model(Scenario, with_absolute_keys(without_lanes(data, where), where), where)
    check_scenario(scenario, where)
    return scenario


def with_oncoming_lane(scenario: Scenario, state: str) -> Scenario:
    """Return a scenario with its oncoming lane `free`, or `occupied` by a car; empty: as it is.

    That car is as fast as the car under test, and as far from the crossing line when an episode starts.

    Raises:
        UsageError: no car can come there.
    """
    if state in ("", scenario.oncoming_lane):
        return scenario
    if state == FREE:
        return dataclasses.replace(scenario, others=tuple(one for one in scenario.others if not scenario.comes(one)))
    car, lane = scenario.car, scenario.oncoming_lanes[0]
    speed, start = max(car.start_speed, 1.0), car.start_gap + car.front
    end = max(start - speed * scenario.horizon, -_FURTHEST)
    way = [{"time": (start - along) / speed, "lane": lane, "along": along} for along in (start, end)]
    other = {"kind": CAR, "length": 4.5, "width": 1.8, "way": way}
    return scenario_from_dict({**scenario.as_dict(), "others": [*scenario.as_dict().get("others", ()), other]})


def load_scenario(source: str) -> Scenario:
    """Load a scenario by name, shipped or of an installed package, or one from a YAML file by path.

    Raises:
        UsageError: no such scenario, not YAML, or not a valid scenario.
    """
    return scenario_from_dict(scenario_data(source), source)


def changed_scenario(source: str, changes: Mapping[str, Any]) -> Scenario:
    """Return a scenario with some keys of its file changed; what is said relative to its test speed changes with it.

    A place on a lane is coordinates before anything is changed.

    Args:
        source: its name, or the path of its YAML file.
        changes: values by the key's place in the file, as `car.start_speed`.

    Raises:
        UsageError: there is no such scenario or place in it, or it is none with these values.
    """
    content = without_lanes(scenario_data(source), source)
    if not isinstance(content, Mapping):
        return load_scenario(source)  # says what is wrong
    data = dict(content)
    for place, value in changes.items():
        *sections, key = place.split(".")
        section = data
        for name in sections:
            inner = section.get(name, {})
            if not isinstance(inner, Mapping):
                raise UsageError(f"scenario {data.get('name', source)}: {place}: {name} has no keys")
            section[name] = section = dict(inner)
        section[key] = value
    return scenario_from_dict(data, f"scenario {data.get('name', source)}, changed")
