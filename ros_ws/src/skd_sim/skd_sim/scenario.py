"""Scenarios: road, footprints, start states, horizon and time step, from validated YAML.

Every key is known and in range, and required unless it has a default: those of `car.dynamics: multi_body`, `eta_max`,
and the sections `sensor` and `obstacles`. A mistake is one line that names file, key and allowed range.
"""

from __future__ import annotations

import dataclasses
import math
import types
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

from skd_sim.errors import UsageError
from skd_sim.geometry import rectangle_distance, to_car_frame
from skd_sim.motion import braking_distance
from skd_sim.yaml_file import name_of_key, parse_yaml, read_text, short

HEADING_NORTH = math.pi / 2  # the car drives along +y (ENU)


@dataclass(frozen=True)
class _Range:
    """What a number may be; the annotation of every numeric key."""

    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class _Choice:
    """What a text may be; the annotation of a key that names one of several ways."""

    names: tuple[str, ...]


@dataclass(frozen=True)
class Road:
    """A single lane along y, centred on x = 0; the pedestrian crosses it near the line y = 0.

    `friction` is relative to a dry road (1); wet asphalt has about 0.65 (docs/decisions.md). Basic cars have no tyres:
    with them only 1 is accepted.
    """

    lane_width: Annotated[float, _Range(1.0, 20.0, "m")]
    friction: Annotated[float, _Range(0.05, 1.5, "relative to a dry road")] = 1.0


@dataclass(frozen=True)
class Car:
    """Footprint, dynamics and start of the car under test.

    `start_gap` is from the front bumper to the crossing line; an episode adds a draw from [0, start_gap_range).
    With `meet_safe_trajectory` the gap is instead the distance that the unbraked car drives until φ enters its path.
    `dynamics` and the brake's keys say how the car moves (skd_sim/dynamics); the basic car has no use for the latter.
    """

    front: Annotated[float, _Range(0.1, 10.0, "m ahead of the reference point")]
    rear: Annotated[float, _Range(0.1, 20.0, "m behind the reference point")]
    width: Annotated[float, _Range(0.2, 5.0, "m")]
    start_speed: Annotated[float, _Range(0.0, 60.0, "m/s")]
    start_gap: Annotated[float, _Range(0.0, 500.0, "m")]
    start_gap_range: Annotated[float, _Range(0.0, 50.0, "m")]
    meet_safe_trajectory: bool
    deceleration: Annotated[float, _Range(0.1, 15.0, "m/s²")]
    speed_noise: Annotated[float, _Range(0.0, 0.5, "relative")]
    acceleration_noise: Annotated[float, _Range(0.0, 0.9, "relative")]
    dynamics: Annotated[str, _Choice(("basic", "multi_body"))] = "basic"
    brake_delay: Annotated[float, _Range(0.0, 1.0, "s")] = 0.1
    brake_rate: Annotated[float, _Range(1.0, 1000.0, "m/s³")] = 50.0
    brake_limit: Annotated[float, _Range(0.1, 30.0, "m/s²")] = 15.0
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
class Pedestrian:
    """The adversary: a disc that moves at one speed or stays; start and destination of the crossing."""

    radius: Annotated[float, _Range(0.05, 1.0, "m")]
    speed: Annotated[float, _Range(0.1, 10.0, "m/s")]
    start_x: Annotated[float, _Range(-100.0, 100.0, "m")]
    start_y: Annotated[float, _Range(-100.0, 100.0, "m")]
    destination_x: Annotated[float, _Range(-100.0, 100.0, "m")]
    distance_noise: Annotated[float, _Range(0.001, 100.0, "m, standard deviation")]
    position_noise: Annotated[float, _Range(0.001, 100.0, "m per axis, standard deviation")]


@dataclass(frozen=True)
class Collision:
    """What counts as a collision: any touch at or above this car speed."""

    minimum_impact_speed: Annotated[float, _Range(0.0, 60.0, "m/s")]


@dataclass(frozen=True)
class Sensor:
    """Planar laser scanner on the car's axis, looking ahead; beams are spread evenly over the field of view."""

    mount_ahead: Annotated[float, _Range(-20.0, 20.0, "m ahead of the reference point")]
    beams: Annotated[int, _Range(2, 4096, "beams")]
    field_of_view: Annotated[float, _Range(0.01, 2 * math.pi, "rad")]
    maximum_range: Annotated[float, _Range(1.0, 300.0, "m")]
    range_noise: Annotated[float, _Range(0.0, 1.0, "m, standard deviation")]
    dropout: Annotated[float, _Range(0.0, 0.9, "probability per beam")]


@dataclass(frozen=True)
class Obstacle:
    """A parked rectangle that the sensor sees, and that hides what is behind it; it stops nobody."""

    x: Annotated[float, _Range(-100.0, 100.0, "m, centre")]
    y: Annotated[float, _Range(-500.0, 500.0, "m, centre")]
    heading: Annotated[float, _Range(-math.pi, math.pi, "rad, of its length")]
    length: Annotated[float, _Range(0.1, 30.0, "m")]
    width: Annotated[float, _Range(0.1, 30.0, "m")]


@dataclass(frozen=True)
class Scenario:
    """Everything that is fixed about a test: see `load_scenario`.

    The adversary decides every `time_step`, the car every `control_period`, which divides it and is it by default.
    `eta_max` is η_max of the mean deformation: as far as an attempt counts that needs more, or that fails.
    """

    name: str
    description: str
    time_step: Annotated[float, _Range(0.01, 2.0, "s")]
    horizon: Annotated[float, _Range(0.1, 600.0, "s")]
    road: Road
    car: Car
    pedestrian: Pedestrian
    collision: Collision
    eta_max: Annotated[float, _Range(0.01, 1000.0, "m")] = 5.0
    control_period: Annotated[float, _Range(0.001, 2.0, "s")] | None = None
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
        """|x| (m) from which the pedestrian's disc reaches into the strip that the car sweeps."""
        return self.car.half_width + self.pedestrian.radius

    def as_dict(self) -> dict[str, Any]:
        """Return the scenario as plain data; `scenario_from_dict` is the inverse."""
        data = dataclasses.asdict(self)
        return {key: value for key, value in data.items() if value not in (None, ())}


_Section = TypeVar("_Section")


def _build(kind: type[_Section], data: Any, where: str, path: str) -> _Section:
    """Build dataclass `kind` from a mapping, or raise UsageError naming the file, the key and its range."""
    prefix = f"{path}." if path else ""
    if not isinstance(data, Mapping):
        raise UsageError(f"{where}: {path or 'the file'} must be a mapping, got {type(data).__name__}")
    fields = {field.name: field for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    unknown = [key for key in data if key not in fields]
    if unknown:
        raise UsageError(f"{where}: unknown key {prefix}{name_of_key(unknown[0])}; allowed: {', '.join(fields)}")
    hints = get_type_hints(kind, include_extras=True)
    values: dict[str, Any] = {}
    for name in fields:
        if name not in data:
            if fields[name].default is not dataclasses.MISSING:
                continue
            raise UsageError(f"{where}: missing key {prefix}{name}")
        values[name] = _value(hints[name], data[name], where, f"{prefix}{name}")
    return kind(**values)


def _value(kind: Any, value: Any, where: str, key: str) -> Any:
    if dataclasses.is_dataclass(kind):
        return _build(cast(type[Any], kind), value, where, key)
    if get_origin(kind) in (types.UnionType, Union):  # what is optional, and there
        return _value(get_args(kind)[0], value, where, key)
    if get_origin(kind) is tuple:
        if not isinstance(value, (list, tuple)):
            raise UsageError(f"{where}: {key} must be a list, got {type(value).__name__}")
        return tuple(_build(get_args(kind)[0], item, where, f"{key}[{index}]") for index, item in enumerate(value))
    if kind is str:
        if not isinstance(value, str):
            raise UsageError(f"{where}: {key} must be text, got {short(value)}")
        return value
    if kind is bool:
        if not isinstance(value, bool):
            raise UsageError(f"{where}: {key} must be true or false, got {short(value)}")
        return value
    limits = kind.__metadata__[0]
    if isinstance(limits, _Choice):
        if value not in limits.names:
            raise UsageError(f"{where}: {key} must be one of {', '.join(limits.names)}; got {short(value)}")
        return value
    low, high, unit = limits.low, limits.high, limits.unit
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not number or not low <= value <= high:
        raise UsageError(f"{where}: {key} must be a number from {low:g} to {high:g} ({unit}), got {short(value)}")
    if kind.__origin__ is int:
        if value != int(value):
            raise UsageError(f"{where}: {key} must be a whole number ({unit}), got {short(value)}")
        return int(value)
    return float(value)


def scenario_from_dict(data: Any, where: str = "scenario") -> Scenario:
    """Build and check a scenario from plain data.

    Args:
        data: nested mapping with the keys of `Scenario`.
        where: file or other origin, for messages.

    Raises:
        UsageError: a key is missing, unknown or out of range, or the car overlaps the pedestrian at the start.
    """
    scenario = _build(Scenario, data, where, "")
    if scenario.horizon < scenario.time_step:
        raise UsageError(f"{where}: horizon must be at least time_step ({scenario.time_step:g} s)")
    check_control_period(scenario, where)
    if scenario.pedestrian.destination_x <= scenario.pedestrian.start_x:
        raise UsageError(f"{where}: pedestrian.destination_x must be greater than pedestrian.start_x")
    if scenario.car.dynamics == "basic" and scenario.road.friction != 1.0:
        raise UsageError(
            f"{where}: road.friction {scenario.road.friction:g} has no effect on car.dynamics basic; "
            "set car.dynamics to multi_body, or leave road.friction out"
        )
    if not scenario.car.meet_safe_trajectory:
        check_start(scenario, scenario.pedestrian.start_x, scenario.pedestrian.start_y, where)
    return scenario


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


def check_start(scenario: Scenario, x: float, y: float, where: str) -> None:
    """Refuse a start at which the car, anywhere in its start range, overlaps a pedestrian at (x, y) (m)."""
    car, radius = scenario.car, scenario.pedestrian.radius
    nearest = -car.start_gap - car.front
    ahead, left = to_car_frame(x, y, 0.0, nearest, HEADING_NORTH)
    gap = rectangle_distance(ahead, left, car.front, car.rear + car.start_gap_range, car.half_width)
    if gap <= radius:
        raise UsageError(
            f"{where}: the car overlaps the pedestrian at the start (footprint to centre {gap:.2f} m, must exceed "
            f"pedestrian.radius {radius:g} m); increase car.start_gap or move pedestrian.start_x, start_y"
        )


def shipped_scenarios() -> list[str]:
    """Return the names of the scenarios that come with the package."""
    folder = resources.files("skd_sim") / "scenarios"
    return sorted(entry.name.removesuffix(".yaml") for entry in folder.iterdir() if entry.name.endswith(".yaml"))


def load_scenario(source: str) -> Scenario:
    """Load a shipped scenario by name, or one from a YAML file by path.

    Raises:
        UsageError: no such scenario, not YAML, or not a valid scenario.
    """
    if source in shipped_scenarios():
        text = (resources.files("skd_sim") / "scenarios" / f"{source}.yaml").read_text(encoding="utf-8")
    else:
        try:
            text = read_text(Path(source))
        except (OSError, ValueError) as error:
            if isinstance(error, UsageError):
                raise
            known = ", ".join(shipped_scenarios())
            raise UsageError(f"scenario {source}: not a readable file, nor one of: {known}") from error
    return scenario_from_dict(parse_yaml(text, source), source)
