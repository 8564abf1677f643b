"""What a scenario's file may say in other words, and as which coordinates and lengths the scenario holds it.

The adversary, an obstacle and a waypoint of one of the others may have `lane` and `along` (and `aside`) in place of x
and y, a region of the section `ending` a `lane` in place of its bounds to the right and to the left. The car's start
may be said by time, so that one file serves every test speed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from skd_sim.errors import UsageError
from skd_sim.inputs.model import ON_LANE, Frozen, limits, read_model
from skd_sim.scenario.road import Road

_SPACING = 1.0  # m between points of a way that follows a curve
_BY_TIME = {"start_time": "start_gap", "start_time_range": "start_gap_range"}


@dataclass(frozen=True)
class _Whole(Frozen):
    """All of a lane."""

    lane: Annotated[int, limits(-99, 99, "number of a lane")]


@dataclass(frozen=True)
class _LanePlace(_Whole):
    """A place on a lane; see `Road.place`."""

    along: Annotated[float, limits(-500.0, 500.0, "m along the lane")]
    aside: Annotated[float, limits(-50.0, 50.0, "m to the right of the lane's middle")] = 0.0


@dataclass(frozen=True, kw_only=True)
class _TimedPlace(_LanePlace):
    """Where a road user is on a lane, and when."""

    time: Annotated[float, limits(0.0, 600.0, "s since the start")]


_P = TypeVar("_P", bound=_Whole)


def without_lanes(data: Any, where: str) -> Any:
    """Return a scenario's content with coordinates where it has lanes; anything else is returned as it is.

    Args:
        data: content of a scenario; it is not changed.
        where: file or other origin, for messages.

    Raises:
        UsageError: there is no such lane, or both a lane and coordinates.
    """
    if not isinstance(data, Mapping) or not isinstance(data.get("road"), Mapping) or not _names_lanes(data):
        return data
    lanes = _Lanes(read_model(Road, data["road"], where, "road"), where)
    found = dict(data)
    if "adversary" in found:
        found["adversary"] = lanes.placed(found["adversary"], "adversary", ("start_x", "start_y", "start_heading"))
    if isinstance(found.get("ending"), Mapping):
        found["ending"] = {key: lanes.region(one, f"ending.{key}") for key, one in found["ending"].items()}
    if isinstance(found.get("obstacles"), (list, tuple)):
        found["obstacles"] = [
            lanes.placed(one, f"obstacles[{index}]", ("x", "y", "heading"))
            for index, one in enumerate(found["obstacles"])
        ]
    if isinstance(found.get("others"), (list, tuple)):
        found["others"] = [lanes.other(one, f"others[{index}]") for index, one in enumerate(found["others"])]
    return found


def _on_lane(section: Any) -> bool:
    """Return whether a section has one of the keys that stand for coordinates."""
    return isinstance(section, Mapping) and any(key in section for key in ON_LANE)


def _names_lanes(data: Any) -> bool:
    """Return whether a content, or anything in it, has one of the keys that stand for coordinates."""
    inner = data.values() if isinstance(data, Mapping) else data if isinstance(data, (list, tuple)) else ()
    return _on_lane(data) or any(_names_lanes(one) for one in inner)


class _Lanes:
    """Puts coordinates in the place of lanes of one road."""

    def __init__(self, road: Road, where: str) -> None:
        self._road, self._where = road, where

    def placed(self, section: Any, path: str, names: tuple[str, str, str]) -> Any:
        """Return a section with x, y and, if it has none of its own, the lane's heading.

        Args:
            section: content of a section; one that names no lane is returned as it is.
            path: name of the section, for messages.
            names: keys of x, y and heading in it.
        """
        if not _on_lane(section):
            return section
        place = self._place(_LanePlace, section, path, names[:2])
        rest = {key: value for key, value in section.items() if key not in ON_LANE}
        return dict(zip(names, self._road.place(place.lane, place.along, place.aside), strict=True)) | rest

    def _place(self, kind: type[_P], section: Mapping[str, Any], path: str, instead: tuple[str, ...]) -> _P:
        """Return the place that a section names, which must not be given by other keys as well."""
        for name in instead:
            if name in section:
                raise UsageError(f"{self._where}: {path} has a lane and {name}; leave one out")
        keys = kind.__dataclass_fields__
        place = read_model(kind, {key: section[key] for key in keys if key in section}, self._where, path)
        if place.lane not in self._road.every_lane:
            known = ", ".join(str(number) for number in sorted(self._road.every_lane))
            raise UsageError(
                f"{self._where}: {path}.lane: the road has no lane {place.lane}; it has {known} (road.lanes)"
            )
        return place

    def region(self, region: Any, path: str) -> Any:
        """Return a region with its bounds to the right and to the left."""
        if not _on_lane(region):
            return region
        lane = self._place(_Whole, region, path, ("right_of", "left_of", "along", "aside")).lane
        if not self._road.every_lane[lane].beside:
            raise UsageError(f"{self._where}: {path}.lane {lane} is elsewhere; a region is beside and along the road")
        middle, half = self._road.offset(lane), 0.5 * self._road.width(lane)
        rest = {key: value for key, value in region.items() if key != "lane"}
        return {"right_of": middle - half, "left_of": middle + half, **rest}

    def other(self, other: Any, path: str) -> Any:
        """Return one of the others with coordinates in its way; on a curve it follows the lanes."""
        if not isinstance(other, Mapping) or not isinstance(other.get("way"), (list, tuple)):
            return other
        way: list[Any] = []
        before: _TimedPlace | None = None
        heading = {}
        for index, point in enumerate(other["way"]):
            if not _on_lane(point):
                way.append(point)
                before = None
                continue
            place = self._place(_TimedPlace, point, f"{path}.way[{index}]", ("x", "y"))
            if before is not None:
                way += self._between(before, place)
            before = place
            x, y, turned = self._road.place(place.lane, place.along, place.aside)
            way.append({"x": x, "y": y} | {key: value for key, value in point.items() if key not in ON_LANE})
            if index == 0:
                heading = {"start_heading": turned}
        return {**heading, **other, "way": way}

    def _between(self, first: _TimedPlace, last: _TimedPlace) -> list[dict[str, float]]:
        """Return the points between two of a way along a curved road; none along a straight one."""
        road = self._road
        if road.straight or not all(road.every_lane[place.lane].beside for place in (first, last)):
            return []
        right = [road.offset(place.lane) + place.aside for place in (first, last)]
        count = math.ceil(abs(last.along - first.along) / _SPACING)
        found = []
        for number in range(1, count):
            share = number / count
            along = first.along + share * (last.along - first.along)
            x, y, _ = road.place(0, along, right[0] + share * (right[1] - right[0]))
            found.append({"time": first.time + share * (last.time - first.time), "x": x, "y": y})
        return found


def with_absolute_keys(data: Any, where: str) -> Any:
    """Return a scenario's content with lengths and speeds in place of what is said relative to the car's start speed.

    `car.start_time` and `car.start_time_range` (s) stand for `start_gap` and `start_gap_range`. A protocol without
    `speed` has a target as fast as the car; and an adversary without `start_speed` comes as fast as a target that has
    been moving before. What is no number is left to the model.

    Args:
        data: content of a scenario; it is not changed.
        where: file or other origin, for messages.

    Raises:
        UsageError: a length is given in both ways.
    """
    if not isinstance(data, Mapping) or not isinstance(data.get("car"), Mapping):
        return data
    found, car = dict(data), dict(data["car"])
    speed = car.get("start_speed")
    for by_time, key in _BY_TIME.items():
        if by_time not in car:
            continue
        if key in car:
            raise UsageError(f"{where}: car.{by_time} and car.{key} both say where the car starts; leave one out")
        time = car.pop(by_time)
        if any(isinstance(value, bool) or not isinstance(value, (int, float)) for value in (time, speed)):
            raise UsageError(f"{where}: car.{by_time} must be a number (s), and go with the number car.start_speed")
        car[key] = time * speed
    found["car"] = car
    if isinstance(data.get("protocol"), Mapping):
        protocol = {"speed": speed, **data["protocol"]}
        found["protocol"] = protocol
        adversary = data.get("adversary")
        if isinstance(adversary, Mapping) and not protocol.get("acceleration_distance"):
            found["adversary"] = {"start_speed": protocol["speed"], **adversary}
    return found
