"""Writes episodes as ASAM OpenSCENARIO XML 1.2 or CommonRoad XML 2020a, and roads as ASAM OpenDRIVE 1.8.

OpenSCENARIO: road users on polylines with a time at each vertex. An entity's origin is SKD's reference point; its
bounding box says where the body is around it. Vertices are the states at ticks and that at the contact.

OpenDRIVE: the reference line is the middle of the car's lane. A lane offset moves the lanes' zero to the left edge of
those that run as the car drives, so that these have ids −1, −2, … from left to right, and those to their left 1, 2, ….
Lanes elsewhere are roads of their own, which cross the first without a junction.

CommonRoad: states at whole ticks, so the last state of a kamikaze is that of the tick in which the contact was. An
object's position is the middle of its shape. The planning problem is the car's: from where it begins, along its lane.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from skd_sim.inputs.files import one_line
from skd_sim.scenario.road import ONCOMING, Road, right_and_along, road_curvature, road_pose
from skd_sim.scenario.road_user import CAR, height_of
from skd_sim.world.state import FloatArray

from skd_evaluator.extensions.exchange import scene
from skd_evaluator.report.html.template import filled


def number(value: float) -> str:
    """Return the shortest text that is read back as a number is, without an exponent, which decimals of XML lack."""
    return str(np.format_float_positional(float(value), trim="0"))


def _write(path: Path, template: str, **values: Any) -> None:
    path.write_text(
        filled("skd_evaluator.extensions.exchange", template, n=number, zip=zip, **values), encoding="utf-8"
    )


# --- OpenDRIVE


def write_road(path: Path, recorded: Sequence[scene.ExportedEpisode]) -> None:
    """Write the road on which some episodes of one scenario are, as long as they need it."""
    scenario = recorded[0].scenario
    road = scenario.road
    beside = sorted(number for number, lane in road.every_lane.items() if lane.beside)
    elsewhere = [number for number, lane in road.every_lane.items() if not lane.beside]
    roads = [_road(road, beside, scene.stretch(scenario, recorded))]
    roads += [_road(road, [one], scene.stretch(scenario, recorded, one)) for one in elsewhere]
    _write(path, "opendrive.xodr.j2", called=one_line(scenario.name), date=recorded[0].date, roads=roads)


def _road(road: Road, lanes: Sequence[int], span: tuple[float, float]) -> dict[str, Any]:
    """Return what is to be said of a road with lanes, from left to right, between two path coordinates, m."""
    low, high = span
    line = road.line_of(lanes[0])
    pieces = [
        (begin - low, *road_pose(line, begin), end - begin, curvature)
        for begin, end, curvature in _pieces(line, low, high)
    ]
    runs = {one: road.every_lane[one].direction != ONCOMING for one in lanes}
    left = [one for one in lanes if one < 0 and not all(runs[other] for other in lanes if one <= other < 0)]
    right = [one for one in lanes if one not in left]
    edge = road.offset(right[0]) - 0.5 * road.width(right[0])  # to the right of the reference line
    # Those on the right run along the reference line, those on the left against it.
    said = {
        one: {"id": id_, "width": road.width(one), "is_reversed": runs[one] != (id_ < 0)}
        for lanes_of_side, ids in ((left, range(len(left), 0, -1)), (right, range(-1, -1 - len(right), -1)))
        for one, id_ in zip(lanes_of_side, ids, strict=True)
    }
    sides = {"left": [said[one] for one in left], "right": [said[one] for one in right]}
    return {"length": high - low, "pieces": pieces, "offset": -edge, **sides}


def _pieces(line: FloatArray, low: float, high: float) -> list[tuple[float, float, float]]:
    """Return the stretches of a line of one curvature each: path coordinates of both ends (m), and curvature (1/m)."""
    inner = {float(s) for row in line for s in (row[0], row[0] + row[5]) if low < s < high}
    found: list[tuple[float, float, float]] = []
    for begin, end in pairwise(sorted({low, high, *inner})):
        curvature = float(road_curvature(line, 0.5 * (begin + end)))
        if found and found[-1][2] == curvature:
            begin = found.pop()[0]
        found.append((begin, end, curvature))
    return found


# --- OpenSCENARIO


def write_openscenario(path: Path, recorded: scene.ExportedEpisode) -> None:
    """Write an episode; its road is in the file `ROAD_FILE` beside it.

    A car that was left out begins as it did, and another may drive it.
    """
    car, actors = recorded.scenario.car, recorded.actors
    if recorded.ego is None:
        size, centre = (car.front + car.rear, car.width, height_of(CAR)), 0.5 * (car.front - car.rear)
        actors = (
            scene.Actor(scene.EGO, scene.EGO_ID, None, size, centre, np.zeros(1), np.array([recorded.start])),
            *actors,
        )
    moving = [one for one in actors if not one.stands]
    about = {"recorded": recorded, "road_file": scene.ROAD_FILE, "ego": scene.EGO}
    _write(path, "openscenario.xosc.j2", actors=actors, moving=moving, **about)


# --- CommonRoad

_FIRST_LANELET = 10_001
_GOAL = 20.0  # m behind the crossing line, and so long


def write_commonroad(path: Path, recorded: scene.ExportedEpisode) -> None:
    """Write an episode.

    The car's task: from where it begins, to be beyond the crossing line within the scenario's horizon.
    """
    scenario, lanes = recorded.scenario, scene.lanes_of(recorded)
    x, y, heading, speed = recorded.start
    ahead = 0.5 * (scenario.car.front - scenario.car.rear)
    along = float(right_and_along(scenario.road.line, np.array([[x, y]]))[0, 1])
    goal = dict(zip(("x", "y", "heading"), road_pose(scenario.road.line, max(_GOAL, along + _GOAL)), strict=True))

    def rows(actor: scene.Actor) -> list[list[float]]:
        ticks = np.rint(actor.times / scenario.time_step)
        found: list[list[float]] = np.column_stack([actor.centres, actor.states[:, 2:], ticks]).tolist()
        return found

    _write(
        path,
        "commonroad.xml.j2",
        recorded=recorded,
        called="".join(one for one in scenario.name.title() if one.isascii() and one.isalnum()) or "Skd",
        lanes=lanes,
        ids={lane.number: _FIRST_LANELET + index for index, lane in enumerate(lanes)},
        directions={number: lane.direction for number, lane in scenario.road.every_lane.items()},
        rows=rows,
        remainder=lambda angle: math.remainder(angle, math.tau),
        begin=(x + ahead * math.cos(heading), y + ahead * math.sin(heading), heading, speed, 0),
        goal={"length": _GOAL, "width": scenario.road.lane_width, **goal},
    )
