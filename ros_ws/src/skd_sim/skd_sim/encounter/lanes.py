"""Places that a scenario's file gives by lanes, as coordinates: what a scenario holds are coordinates alone.

The adversary, an obstacle and a waypoint of one of the others may have `lane` and `along` (and `aside`) in place of x
and y, a region of the section `ending` a `lane` in place of its bounds to the right and to the left.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from skd_sim.encounter.reader import build
from skd_sim.encounter.road import Road
from skd_sim.errors import UsageError
from skd_sim.inputs.keys import ON_LANE, Range

_SPACING = 1.0  # m between points of a way that follows a curve
_LANE = Range(-99, 99, "number of a lane")


@dataclass(frozen=True)
class _Place:
    """A place on a lane; see `Road.place`."""

    lane: Annotated[int, _LANE]
    along: Annotated[float, Range(-500.0, 500.0, "m along the lane")]
    aside: Annotated[float, Range(-50.0, 50.0, "m to the right of the lane's middle")] = 0.0


@dataclass(frozen=True)
class _Whole:
    """All of a lane."""

    lane: Annotated[int, _LANE]


def off_lanes(data: Any, where: str) -> Any:
    """Return a scenario's content with coordinates where it has lanes; anything else is returned as it is.

    Args:
        data: content of a scenario; it is not changed.
        where: file or other origin, for messages.

    Raises:
        UsageError: there is no such lane, or both a lane and coordinates.
    """
    if not isinstance(data, Mapping) or not isinstance(data.get("road"), Mapping) or not _names_lanes(data):
        return data
    road = build(Road, data["road"], where, "road")
    road.check(where)
    found, reader = dict(data), _Reader(road, where)
    if _on_lane(found.get("adversary")):
        found["adversary"] = reader.placed(found["adversary"], "adversary", ("start_x", "start_y", "start_heading"))
    if isinstance(found.get("ending"), Mapping):
        found["ending"] = {key: reader.region(one, f"ending.{key}") for key, one in found["ending"].items()}
    if isinstance(found.get("obstacles"), (list, tuple)):
        found["obstacles"] = [
            reader.placed(one, f"obstacles[{index}]", ("x", "y", "heading")) if _on_lane(one) else one
            for index, one in enumerate(found["obstacles"])
        ]
    if isinstance(found.get("others"), (list, tuple)):
        found["others"] = [reader.other(one, f"others[{index}]") for index, one in enumerate(found["others"])]
    return found


def _on_lane(section: Any) -> bool:
    """Return whether a section has one of the keys that stand for coordinates."""
    return isinstance(section, Mapping) and any(key in section for key in ON_LANE)


def _names_lanes(data: Any) -> bool:
    """Return whether a content, or anything in it, has one of the keys that stand for coordinates."""
    inner = data.values() if isinstance(data, Mapping) else data if isinstance(data, (list, tuple)) else ()
    return _on_lane(data) or any(_names_lanes(one) for one in inner)


class _Reader:
    """Puts coordinates in the place of lanes of one road."""

    def __init__(self, road: Road, where: str) -> None:
        self._road, self._where = road, where

    def placed(self, section: Mapping[str, Any], path: str, names: tuple[str, str, str]) -> dict[str, Any]:
        """Return a section with x, y and, if it has none of its own, the lane's heading.

        Args:
            section: content of a section that names a lane.
            path: name of the section, for messages.
            names: keys of x, y and heading in it.
        """
        place, rest = self._place(section, path, names[:2])
        return dict(zip(names, self._road.place(place.lane, place.along, place.aside), strict=True)) | rest

    def _place(self, section: Mapping[str, Any], path: str, names: Sequence[str]) -> tuple[_Place, dict[str, Any]]:
        """Return the place that a section names, and the rest of the section."""
        for name in names:
            if name in section:
                raise UsageError(f"{self._where}: {path} has a lane and {name}; give lane and along, or coordinates")
        place = build(_Place, {key: section[key] for key in ON_LANE if key in section}, self._where, path)
        self._known(place.lane, path)
        return place, {key: value for key, value in section.items() if key not in ON_LANE}

    def _known(self, lane: int, path: str) -> None:
        if lane not in self._road.every_lane:
            known = ", ".join(str(number) for number in sorted(self._road.every_lane))
            raise UsageError(f"{self._where}: {path}.lane: the road has no lane {lane}; it has {known} (road.lanes)")

    def region(self, region: Any, path: str) -> Any:
        """Return a region with its bounds to the right and to the left."""
        if not _on_lane(region):
            return region
        for name in ("right_of", "left_of", "along", "aside"):
            if name in region:
                raise UsageError(f"{self._where}: {path} has a lane and {name}; a lane bounds it to right and left")
        lane = build(_Whole, {"lane": region["lane"]}, self._where, path).lane
        self._known(lane, path)
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
        before: tuple[float, _Place] | None = None
        heading = {}
        for index, point in enumerate(other["way"]):
            here = f"{path}.way[{index}]"
            if not _on_lane(point):
                way.append(point)
                before = None
                continue
            place, rest = self._place(point, here, ("x", "y"))
            time = build(_Time, {"time": rest["time"]} if "time" in rest else {}, self._where, here).time
            if before is not None:
                way += self._between(*before, time, place)
            before = time, place
            x, y, turned = self._road.place(place.lane, place.along, place.aside)
            way.append({"x": x, "y": y, **rest})
            if index == 0:
                heading = {"start_heading": turned}
        return {**heading, **other, "way": way}

    def _between(self, begin: float, first: _Place, end: float, last: _Place) -> list[dict[str, float]]:
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
            found.append({"time": begin + share * (end - begin), "x": x, "y": y})
        return found


@dataclass(frozen=True)
class _Time:
    """When somebody is at a point of a way."""

    time: Annotated[float, Range(0.0, 600.0, "s since the start")]
