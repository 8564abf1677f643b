"""Ways out of OpenSCENARIO XML: the polylines with a time at each vertex that its entities follow."""

from __future__ import annotations

from collections.abc import Iterator
from xml.etree.ElementTree import Element

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.inputs.numbers import finite_number

from skd_evaluator.extensions.exchange.coming_in.found import Found, track_of

ROOT = "OpenSCENARIO"


def read_openscenario(root: Element, where: str) -> list[Found]:
    """Return every entity that follows a polyline with times, in a position of the world at each vertex.

    Args:
        root: root of the document.
        where: name of the file, for messages.

    Raises:
        UsageError: an entity has two such ways, or begins within one, a vertex has no time or no place of the world, or
            times are not those of the simulation.
    """
    found: dict[str, Found] = {}
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
            found[name] = Found(name, track, kinds.get(name, ""))
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
