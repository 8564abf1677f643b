"""The road of a scenario as ASAM OpenDRIVE 1.8: straight and circular parts, and the lanes beside them.

The reference line is the middle of the car's lane. A lane offset moves the lanes' zero to the left edge of those that
go the car's way, so that these have ids −1, −2, … from left to right, and those to their left 1, 2, …. Lanes elsewhere
are roads of their own, which cross the first without a junction: SKD knows no way from one to the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from xml.etree.ElementTree import Element

from skd_sim.arrays import FloatArray
from skd_sim.inputs.printable import one_line
from skd_sim.scenario.road import ONCOMING, Road, road_curvature, road_pose
from skd_sim.scenario.scenario import Scenario

from skd_evaluator.extensions.exchange.going_out.recorded import Recorded, stretch
from skd_evaluator.extensions.exchange.going_out.xml_text import add, as_bytes

MINOR = 8
"""Of version 1.8, the first in which a lane can say that it is driven the other way."""


def write_road(path: Path, recorded: Sequence[Recorded]) -> None:
    """Write the road on which some episodes of one scenario are, as long as they need it."""
    path.write_bytes(as_bytes(opendrive(recorded[0].scenario, recorded)))


def opendrive(scenario: Scenario, recorded: Sequence[Recorded]) -> Element:
    """Return the road of a scenario, as far as some episodes need it."""
    road, root = scenario.road, Element("OpenDRIVE")
    header = {"name": one_line(scenario.name), "version": "1.00", "date": recorded[0].date}
    add(root, "header", revMajor="1", revMinor=str(MINOR), **header)
    beside = sorted(number for number, lane in road.every_lane.items() if lane.beside)
    _add_road(root, road, 0, beside, stretch(scenario, recorded))
    elsewhere = [number for number, lane in road.every_lane.items() if not lane.beside]
    for index, number in enumerate(elsewhere):
        _add_road(root, road, index + 1, [number], stretch(scenario, recorded, number))
    return root


def _add_road(root: Element, road: Road, number: int, lanes: Sequence[int], span: tuple[float, float]) -> None:
    """Add a road with lanes, by their numbers from left to right, between two path coordinates, m."""
    low, high = span
    found = add(root, "road", name=f"road {number}", length=high - low, id=str(number), junction="-1", rule="RHT")
    add(found, "type", s=0.0, type="town")
    plan, line = add(found, "planView"), road.line_of(lanes[0])
    for begin, end, curvature in _pieces(line, low, high):
        x, y, heading = road_pose(line, begin)
        geometry = add(plan, "geometry", s=begin - low, x=x, y=y, hdg=heading, length=end - begin)
        if curvature == 0.0:
            add(geometry, "line")
        else:
            add(geometry, "arc", curvature=curvature)
    left = [
        one for one in lanes if one < 0 and any(road.every_lane[n].direction == ONCOMING for n in lanes if one <= n < 0)
    ]
    right = [one for one in lanes if one not in left]
    edge = road.offset(right[0]) - 0.5 * road.width(right[0])  # to the right of the reference line
    section = add(found, "lanes")
    add(section, "laneOffset", s=0.0, a=-edge, b=0.0, c=0.0, d=0.0)
    whole = add(section, "laneSection", s=0.0)
    if left:
        side = add(whole, "left")
        for place, lane in enumerate(left):
            _add_lane(side, road, lane, len(left) - place, runs_along=road.every_lane[lane].direction != ONCOMING)
    centre = add(add(whole, "center"), "lane", id="0", type="none", level="false")
    _add_mark(centre, "broken" if left else "solid")
    side = add(whole, "right")
    for place, lane in enumerate(right):
        _add_lane(side, road, lane, -1 - place, runs_along=road.every_lane[lane].direction != ONCOMING)


def _pieces(line: FloatArray, low: float, high: float) -> list[tuple[float, float, float]]:
    """Return the stretches of a line of one curvature each: path coordinates of both ends (m), and curvature (1/m)."""
    inner = {float(s) for row in line for s in (row[0], row[0] + row[5]) if low < s < high}
    found: list[tuple[float, float, float]] = []
    for begin, end in pairwise(sorted({low, high, *inner})):
        curvature = float(road_curvature(line, 0.5 * (begin + end)))
        if found and found[-1][2] == curvature:
            found[-1] = (found[-1][0], end, curvature)
        else:
            found.append((begin, end, curvature))
    return found


def _add_lane(side: Element, road: Road, lane: int, number: int, *, runs_along: bool) -> None:
    """Add a lane. Those on the right run along the reference line, those on the left against it: right-hand traffic."""
    found = add(side, "lane", id=str(number), type="driving", level="false")
    if runs_along != (number < 0):
        found.set("direction", "reversed")
    add(found, "width", sOffset=0.0, a=road.width(lane), b=0.0, c=0.0, d=0.0)
    _add_mark(found, "solid")


def _add_mark(lane: Element, kind: str) -> None:
    add(lane, "roadMark", sOffset=0.0, type=kind, weight="standard", color="standard", width=0.12, laneChange="both")
