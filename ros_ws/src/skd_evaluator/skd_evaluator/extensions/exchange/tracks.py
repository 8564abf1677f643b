"""Tracks of objects in XML files: OpenSCENARIO polylines with a time at each vertex, CommonRoad trajectories."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.inputs.files import finite_number

from skd_evaluator.extensions.fusion.track import Track

_FEW = 8
_FARTHEST = 1e7  # m


@dataclass(frozen=True, eq=False)
class TrackedObject:
    """An object of a file.

    Attributes:
        name: what the file calls it.
        track: where it was, in the file's frame.
        kind: what the file says it is; empty where it does not say.
        frame: name of the frame; empty where it has none.
    """

    name: str
    track: Track
    kind: str = ""
    frame: str = ""


def track_of(times: Sequence[float] | FloatArray, places: FloatArray, where: str) -> Track:
    """Return a track of positions alone.

    Raises:
        UsageError: there are fewer than two, one is not finite or beyond all roads, or times do not increase.
    """
    at, where_at = np.asarray(times, np.float64), np.asarray(places, np.float64).reshape(-1, 2)
    if len(at) < 2:
        raise UsageError(f"{where}: {len(at)} position{'' if len(at) == 1 else 's'}; a way has at least two")
    if not (np.isfinite(at).all() and np.isfinite(where_at).all()):
        raise UsageError(f"{where}: has a time or a position that is no finite number")
    if (np.diff(at) <= 0.0).any():
        raise UsageError(f"{where}: times must increase strictly, in s")
    if np.abs(where_at).max() > _FARTHEST or np.abs(at).max() > 1e12:
        raise UsageError(f"{where}: has a position or a time beyond all roads; they must be in m and s")
    return Track(at, where_at, None, None, where)


def one_of(found: Sequence[TrackedObject], name: str | None, usual: str, option: str, where: str) -> TrackedObject:
    """Return the object with a name; without one the usual one, else the only one there is.

    Raises:
        UsageError: there is none, or several and none that is usual.
    """
    known = {one.name: one for one in found}
    if name is not None:
        if name not in known:
            raise UsageError(f"{where}: has no {name!r} that moves; it has {listed(list(known))}: name one by {option}")
        return known[name]
    if usual in known:
        return known[usual]
    if len(known) != 1:
        raise UsageError(f"{where}: has {listed(list(known))}: name one by {option}")
    return found[0]


def listed(names: Sequence[str]) -> str:
    """Return names in a few words."""
    shown = [re.sub(r"\s+", " ", one)[:40] for one in names[:_FEW]]
    more = f" and {len(names) - _FEW} more" if len(names) > _FEW else ""
    return (", ".join(map(repr, shown)) or "nobody who moves") + more


OPENSCENARIO = "OpenSCENARIO"


def read_openscenario(root: Element, where: str) -> list[TrackedObject]:
    """Return every entity that follows a polyline with times, in a position of the world at each vertex.

    Args:
        root: root of the document.
        where: name of the file, for messages.

    Raises:
        UsageError: an entity has two such ways, or begins within one, a vertex has no time or no place of the world, or
            times are not those of the simulation.
    """
    found: dict[str, TrackedObject] = {}
    kinds = {one.get("name", ""): _kind(one) for one in root.iter("ScenarioObject")}
    for names, follow in _followed(root):
        trajectory = next(iter(follow.iter("Trajectory")), None)
        line = None if trajectory is None else trajectory.find("Shape/Polyline")
        if line is None:
            continue  # a clothoid, a spline, or one of a catalogue
        for name in names:
            here = f"{where}, {name}"
            if name in found:
                raise UsageError(f"{here}: follows two polylines; give a file in which it follows one")
            rows = [_vertex(one, here) for one in line.findall("Vertex")]
            scale, offset = _timing(follow, here)
            if follow.get("initialDistanceOffset", "0").strip() not in ("0", "0.0"):
                raise UsageError(f"{here}: begins within its polyline (initialDistanceOffset), whose times do not")
            table = np.array(rows, np.float64).reshape(-1, 3)
            track = track_of(scale * table[:, 0] + offset, table[:, 1:], here)
            found[name] = TrackedObject(name, track, kinds.get(name, ""))
    return list(found.values())


def _followed(root: Element) -> Iterator[tuple[list[str], Element]]:
    """Yield who follows which trajectory: by an event, or from the beginning."""
    for group in root.iter("ManeuverGroup"):
        names = [one.get("entityRef", "") for one in group.findall("Actors/EntityRef")]
        for follow in group.iter("FollowTrajectoryAction"):
            yield names, follow
    for private in root.iter("Private"):
        for follow in private.iter("FollowTrajectoryAction"):
            yield [private.get("entityRef", "")], follow


def _kind(entity: Element) -> str:
    """Return what an entity says it is: its own word for SKD, else its category."""
    for one in entity.iter("Property"):
        if one.get("name") == "skd.kind":
            return one.get("value", "")
    for tag, key in (("Vehicle", "vehicleCategory"), ("Pedestrian", "pedestrianCategory")):
        body = entity.find(tag)
        if body is not None:
            return body.get(key, "")
    return ""


def _vertex(vertex: Element, where: str) -> tuple[float, float, float]:
    place = vertex.find("Position/WorldPosition")
    if place is None:
        raise UsageError(
            f"{where}: a vertex is not at a WorldPosition, and nothing else says where it is without a map"
        )
    if vertex.get("time") is None:
        raise UsageError(f"{where}: a vertex has no time, so nothing says when it is there")
    time, x, y = (
        finite_number(one.get(key, ""), f"{where}: {key} of a vertex")
        for one, key in ((vertex, "time"), (place, "x"), (place, "y"))
    )
    return time, x, y


def _timing(follow: Element, where: str) -> tuple[float, float]:
    """Return scale and offset of a trajectory's times, s."""
    timing = follow.find("TimeReference/Timing")
    if timing is None:
        raise UsageError(f"{where}: its polyline is followed without times (TimeReference), so nothing says when")
    scale, offset = (finite_number(timing.get(key, ""), f"{where}: {key} of Timing") for key in ("scale", "offset"))
    if not 1e-6 < scale < 1e6:
        raise UsageError(f"{where}: scale of Timing must be above 0, got {scale:g}")
    return scale, offset


COMMONROAD = "commonRoad"


def read_commonroad(root: Element, where: str) -> list[TrackedObject]:
    """Return every dynamic obstacle that has a trajectory, at its places, which are the middle of its shape.

    Args:
        root: root of the document.
        where: name of the file, for messages.

    Raises:
        UsageError: the time step is none, two obstacles have one id, or a state has no exact time or place.
    """
    step = finite_number(root.get("timeStepSize", ""), f"{where}: timeStepSize")
    if not 0.0 < step < 1e3:
        raise UsageError(f"{where}: timeStepSize must be above 0 s, got {step:g}")
    found: dict[str, TrackedObject] = {}
    for obstacle in root.findall("dynamicObstacle"):
        name = obstacle.get("id", "")
        here = f"{where}, obstacle {name}"
        first, rest = obstacle.find("initialState"), obstacle.findall("trajectory/state")
        if first is None or not rest:
            continue  # occupancies, or nothing
        if name in found:
            raise UsageError(f"{here}: two obstacles have this id; give a file in which each has its own")
        rows = np.array([_state(one, here) for one in (first, *rest)], np.float64)
        track = track_of(step * rows[:, 0], rows[:, 1:], here)
        found[name] = TrackedObject(name, track, (obstacle.findtext("type") or "").strip())
    return list(found.values())


def _state(state: Element, where: str) -> tuple[float, float, float]:
    values = []
    for path in ("time/exact", "position/point/x", "position/point/y"):
        said = state.findtext(path)
        if said is None:
            raise UsageError(f"{where}: a state has no {path}; sets of places or times are not read")
        values.append(finite_number(said.strip(), f"{where}: {path}"))
    tick, x, y = values
    return tick, x, y
