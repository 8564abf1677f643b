"""Scenarios: road, car, adversary, start states, horizon and time step, from validated YAML.

Every key is known and in range, and required unless it has a default: those of `car.dynamics: multi_body`, `eta_max`,
the parts of a road that is not straight, and the sections `sensor` and `obstacles`. A mistake is one line that names
file, key and allowed range.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from skd_sim.arrays import FloatArray
from skd_sim.choices.car_dynamics import BASIC, DYNAMICS
from skd_sim.encounter.ending import Ending
from skd_sim.encounter.keys import Choice, Range
from skd_sim.encounter.known_scenarios import scenario_data
from skd_sim.encounter.reader import build
from skd_sim.encounter.road import HEADING_NORTH, Road, right_and_along, road_pose
from skd_sim.encounter.road_user import RoadUser
from skd_sim.encounter.unchanging import Unchanging
from skd_sim.errors import UsageError
from skd_sim.former_names import scenario_of_today
from skd_sim.geometry.contact import rectangle_distance, to_car_frame
from skd_sim.geometry.motion import braking_distance
from skd_sim.geometry.obstruction import clearance, runs_into
from skd_sim.geometry.trajectory import Trajectory
from skd_sim.state import AdversaryState

_OBSTACLE_SPACING = 0.1  # m between the places of an obstacle that are held against the car's path
_START_SPACING = 0.05  # m between the places at which a car on a curved road is looked at before it starts


@dataclass(frozen=True)
class Car(Unchanging):
    """Footprint, dynamics and start of the car under test.

    `start_gap` is from the front bumper to the crossing line; an episode adds a draw from [0, start_gap_range).
    With `meet_safe_trajectory` the gap is instead the distance that the unbraked car drives until φ enters its path.
    `dynamics` and the brake's keys say how the car moves (skd_sim/dynamics); the basic car has no use for the latter.
    """

    front: Annotated[float, Range(0.1, 10.0, "m ahead of the reference point")]
    rear: Annotated[float, Range(0.1, 20.0, "m behind the reference point")]
    width: Annotated[float, Range(0.2, 5.0, "m")]
    start_speed: Annotated[float, Range(0.0, 60.0, "m/s")]
    start_gap: Annotated[float, Range(0.0, 500.0, "m")]
    start_gap_range: Annotated[float, Range(0.0, 50.0, "m")]
    meet_safe_trajectory: bool
    deceleration: Annotated[float, Range(0.1, 15.0, "m/s²")]
    speed_noise: Annotated[float, Range(0.0, 0.5, "relative")]
    acceleration_noise: Annotated[float, Range(0.0, 0.9, "relative")]
    dynamics: Annotated[str, Choice(tuple(DYNAMICS))] = BASIC
    brake_delay: Annotated[float, Range(0.0, 1.0, "s")] = 0.1
    brake_rate: Annotated[float, Range(1.0, 1000.0, "m/s³")] = 50.0
    brake_limit: Annotated[float, Range(0.1, 30.0, "m/s²")] = 15.0
    antilock: bool = True

    @property
    def half_width(self) -> float:
        """Half of the width, m."""
        return 0.5 * self.width

    @property
    def safe_distance(self) -> float:
        """κ: distance to stop from the start speed at full deceleration, m (paper, "The Cars")."""
        return braking_distance(self.start_speed, self.deceleration)


@dataclass(frozen=True)
class Collision(Unchanging):
    """What counts as a collision, and which collisions count as a hit by the moving car.

    A touch at `minimum_impact_speed` or more of the car's own speed is a collision and ends the episode. It is a *hit*
    at `hit_speed` or more, by default 2 km/h, Euro NCAP's tolerance of impact speeds (Crash Avoidance Frontal v1.1):
    margin, risk and the deformation that ranks count hits, the paper's SKD any collision.
    """

    minimum_impact_speed: Annotated[float, Range(0.0, 60.0, "m/s")]
    hit_speed: Annotated[float, Range(0.0, 60.0, "m/s")] = 0.556

    def is_hit(self, impact_speed: float) -> bool:
        """Tell whether a collision at this speed of the car (m/s) is a hit."""
        return impact_speed >= self.hit_speed


@dataclass(frozen=True)
class Sensor(Unchanging):
    """Planar laser scanner on the car's axis, looking ahead; beams are spread evenly over the field of view."""

    mount_ahead: Annotated[float, Range(-20.0, 20.0, "m ahead of the reference point")]
    beams: Annotated[int, Range(2, 4096, "beams")]
    field_of_view: Annotated[float, Range(0.01, 2 * math.pi, "rad")]
    maximum_range: Annotated[float, Range(1.0, 300.0, "m")]
    range_noise: Annotated[float, Range(0.0, 1.0, "m, standard deviation")]
    dropout: Annotated[float, Range(0.0, 0.9, "probability per beam")]


@dataclass(frozen=True)
class Obstacle(Unchanging):
    """A parked rectangle: it hides what is behind it, and nobody walks through it.

    It stands clear of the strip that the car sweeps, so the car never meets it.
    """

    x: Annotated[float, Range(-100.0, 100.0, "m, centre")]
    y: Annotated[float, Range(-500.0, 500.0, "m, centre")]
    heading: Annotated[float, Range(-math.pi, math.pi, "rad, of its length")]
    length: Annotated[float, Range(0.1, 30.0, "m")]
    width: Annotated[float, Range(0.1, 30.0, "m")]

    @property
    def corners(self) -> FloatArray:
        """Its corners, 4 × 2, m."""
        ahead = 0.5 * self.length * np.array([math.cos(self.heading), math.sin(self.heading)])
        left = 0.5 * self.width * np.array([-math.sin(self.heading), math.cos(self.heading)])
        corners = [ahead + left, left - ahead, -ahead - left, ahead - left]
        return np.asarray(np.array([self.x, self.y]) + np.array(corners))


@dataclass(frozen=True)
class Scenario(Unchanging):
    """Everything that is fixed about a test: see `load_scenario`.

    The adversary decides every `time_step`, the car every `control_period`, which divides it and is it by default.
    `eta_max` is η_max of the mean deformation: as far as an attempt counts that needs more, or that fails.
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
    control_period: Annotated[float, Range(0.001, 2.0, "s")] | None = None
    sensor: Sensor | None = None
    obstacles: tuple[Obstacle, ...] = ()

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
        """The obstacles, n × 5: centre (m), heading (rad), half length, half width (m)."""
        rows = [(one.x, one.y, one.heading, 0.5 * one.length, 0.5 * one.width) for one in self.obstacles]
        return np.array(rows, dtype=np.float64).reshape(len(rows), 5)

    def ran_into_obstacle(self, adversary: AdversaryState) -> bool:
        """Return whether the adversary touched an obstacle in the time step that ended in this state."""
        if not self.obstacles:
            return False
        x, y, vx, vy, _ = adversary
        before = x - self.time_step * vx, y - self.time_step * vy
        return bool(runs_into(self.rectangles, *before, x, y, self.adversary.core))

    @cached_property
    def ending(self) -> Ending:
        """When it is over, by path coordinates."""
        return Ending(self.road.line, self.path_edge, self.adversary.destination_x)

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
            given[key] = tuple(_given(item) for item in value)
        elif value not in (None, ()):
            given[key] = value
    return given


def scenario_from_dict(data: Any, where: str = "scenario") -> Scenario:
    """Build and check a scenario from plain data.

    Args:
        data: nested mapping with the keys of `Scenario`, or with those of before (`skd_sim.former_names`).
        where: file or other origin, for messages.

    Raises:
        UsageError: a key is missing, unknown or out of range, or the car overlaps the adversary at the start.
    """
    scenario = build(Scenario, scenario_of_today(data, where), where, "")
    scenario.road.check(where)
    scenario.adversary.check(where)
    if scenario.horizon < scenario.time_step:
        raise UsageError(f"{where}: horizon must be at least time_step ({scenario.time_step:g} s)")
    check_control_period(scenario, where)
    if scenario.adversary.destination_x <= scenario.adversary.start_x:
        raise UsageError(f"{where}: adversary.destination_x must be greater than adversary.start_x")
    if not DYNAMICS[scenario.car.dynamics].tyres and scenario.road.friction != 1.0:
        others = " or ".join(name for name, kind in DYNAMICS.items() if kind.tyres)
        raise UsageError(
            f"{where}: road.friction {scenario.road.friction:g} has no effect on car.dynamics {scenario.car.dynamics}; "
            f"set car.dynamics to {others}, or leave road.friction out"
        )
    if not DYNAMICS[scenario.car.dynamics].steers and not scenario.road.straight:
        others = " or ".join(name for name, kind in DYNAMICS.items() if kind.steers)
        raise UsageError(
            f"{where}: car.dynamics {scenario.car.dynamics} does not steer, so it cannot follow the curves of "
            f"road.parts; set car.dynamics to {others}, or leave road.parts out"
        )
    _check_obstacles(scenario, where)
    if not scenario.car.meet_safe_trajectory:
        check_start(scenario, scenario.adversary.start_x, scenario.adversary.start_y, where)
    return scenario


def _check_obstacles(scenario: Scenario, where: str) -> None:
    """Refuse obstacles in the car's path, for it does not steer around them, and one where the adversary starts."""
    needed, adversary = scenario.car.half_width, scenario.adversary
    for index, (row, obstacle) in enumerate(zip(scenario.rectangles, scenario.obstacles, strict=True)):
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


def check_way(scenario: Scenario, trajectory: Trajectory) -> None:
    """Refuse a way of the adversary that leads through an obstacle.

    Raises:
        UsageError: it does; says through which, and when.
    """
    points, core = trajectory.positions, scenario.adversary.core
    for index, row in enumerate(scenario.rectangles):
        for tick in range(len(points)):
            before = points[max(0, tick - 1)]
            if runs_into(row[None], before[0], before[1], points[tick, 0], points[tick, 1], core):
                raise UsageError(
                    f"safe trajectory {trajectory.name!r} runs into obstacles[{index}] of scenario {scenario.name} at "
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
        scenario: gives road and car.
        x: of the point.
        y: of the point.
        gap: least distance from the front bumper to the crossing line, m.
    """
    car, nearest = scenario.car, -gap - scenario.car.front
    if scenario.road.straight:
        ahead, left = to_car_frame(x, y, 0.0, nearest, HEADING_NORTH)
        return float(rectangle_distance(ahead, left, car.front, car.rear + car.start_gap_range, car.half_width))
    places = np.linspace(nearest - car.start_gap_range, nearest, 2 + int(car.start_gap_range / _START_SPACING))
    seen = [to_car_frame(x, y, *road_pose(scenario.road.line, place)) for place in places]
    return min(float(rectangle_distance(*here, car.front, car.rear, car.half_width)) for here in seen)


def check_start(scenario: Scenario, x: float, y: float, where: str) -> None:
    """Refuse a start at which the car, anywhere in its start range, overlaps an adversary at (x, y) (m)."""
    gap, reach = start_clearance(scenario, x, y, scenario.car.start_gap), scenario.adversary.reach
    if gap <= reach:
        what = "half of the adversary's diagonal," if scenario.adversary.is_box else "adversary.radius"
        raise UsageError(
            f"{where}: the car overlaps the adversary at the start (footprint to centre {gap:.2f} m, must exceed "
            f"{what} {reach:g} m); increase car.start_gap or move adversary.start_x, start_y"
        )


def load_scenario(source: str) -> Scenario:
    """Load a scenario by name, shipped or of an installed package, or one from a YAML file by path.

    Raises:
        UsageError: no such scenario, not YAML, or not a valid scenario.
    """
    return scenario_from_dict(scenario_data(source), source)
