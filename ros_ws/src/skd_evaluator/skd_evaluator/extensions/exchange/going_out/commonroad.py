"""An episode as a CommonRoad scenario (XML, version 2020a): states at whole ticks, lanelets, a planning problem.

CommonRoad knows whole time steps alone, so the last state of a kamikaze is that of the tick in which the contact was,
in which shapes overlap. An object's position is the middle of its shape. The planning problem is the car's: from where
it begins, along its lane.
"""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from skd_sim.scenario.road import ONCOMING, right_and_along, road_pose

from skd_evaluator.extensions.exchange.going_out.recorded import Actor, Recorded, stretch
from skd_evaluator.extensions.exchange.going_out.xml_text import add, as_bytes, text

_FORMAT = "commonroad"
_FIRST_LANELET = 10_001
_PROBLEM = 20_001
_GOAL = 20.0  # m behind the crossing line, and so long


def write_commonroad(path: Path, recorded: Recorded) -> None:
    """Write an episode."""
    path.write_bytes(as_bytes(commonroad(recorded)))


def commonroad(recorded: Recorded) -> Element:
    """Return an episode as a document."""
    name = "".join(one for one in recorded.scenario.name.title() if one.isascii() and one.isalnum()) or "Skd"
    root = Element("commonRoad")
    for key, value in (
        ("commonRoadVersion", "2020a"),
        ("benchmarkID", f"ZAM_{name}-1_1_T-1"),
        ("date", recorded.date[:10]),
        ("author", "SKD"),
        ("affiliation", "SKD"),
        ("source", recorded.title),
    ):
        root.set(key, value)
    place = add(root, "location")
    for key, unknown in (("geoNameId", "-999"), ("gpsLatitude", "999"), ("gpsLongitude", "999")):
        text(place, key, unknown)
    add(add(root, "scenarioTags"), "simulated")
    _add_lanelets(root, recorded)
    step = recorded.scenario.time_step
    root.set("timeStepSize", text(Element("none"), "step", step).text or "")
    for actor in recorded.actors:
        if actor.stands:
            _add_object(root, actor, step)
    for actor in recorded.actors:
        if not actor.stands:
            _add_object(root, actor, step)
    _add_problem(root, recorded)
    return root


def _add_lanelets(root: Element, recorded: Recorded) -> None:
    road = recorded.scenario.road
    numbers = sorted(road.every_lane)
    ids = {number: _FIRST_LANELET + index for index, number in enumerate(numbers)}
    for number in numbers:
        lane = road.every_lane[number]
        low, high = stretch(recorded.scenario, [recorded], 0 if lane.beside else number)
        against = lane.direction == ONCOMING
        edges = [road.edge(side, low, high, number) for side in (-1.0, 1.0)]
        if against:  # its own left is the road's right
            edges = [edges[1][::-1], edges[0][::-1]]
        found = add(root, "lanelet", id=str(ids[number]))
        for tag, edge in zip(("leftBound", "rightBound"), edges, strict=True):
            bound = add(found, tag)
            for x, y in edge.tolist():
                point = add(bound, "point")
                text(point, "x", x)
                text(point, "y", y)
        if lane.beside:
            for tag, side in (("adjacentLeft", 1 if against else -1), ("adjacentRight", -1 if against else 1)):
                next_to = road.every_lane.get(number + side)
                if next_to is not None and next_to.beside:
                    same = "same" if next_to.direction == lane.direction else "opposite"
                    add(found, tag, ref=str(ids[number + side]), drivingDir=same)
        text(found, "laneletType", "urban")


def _add_object(root: Element, actor: Actor, step: float) -> None:
    """Add an object; one that stands is static."""
    found = add(root, "staticObstacle" if actor.stands else "dynamicObstacle", id=str(actor.number))
    parked = "parkedVehicle" if actor.body is not None and actor.body.is_box else "unknown"
    text(found, "type", parked if actor.stands else actor.word(_FORMAT))
    shape, (length, width, _) = add(found, "shape"), actor.size
    if actor.body is not None and not actor.body.is_box:
        text(add(shape, "circle"), "radius", 0.5 * length)
    else:
        box = add(shape, "rectangle")
        text(box, "length", length)
        text(box, "width", width)
    places, ticks = actor.centres, np.rint(actor.times / step).astype(int)
    trajectory = None
    for tick, (x, y), (_, _, heading, speed) in zip(
        ticks.tolist(), places.tolist(), actor.states.tolist(), strict=True
    ):
        if tick and trajectory is None:
            trajectory = add(found, "trajectory")
        state = add(found, "initialState") if trajectory is None else add(trajectory, "state")
        _fill(state, x, y, heading, speed, tick)


def _fill(state: Element, x: float, y: float, heading: float, speed: float, tick: int) -> None:
    point = add(add(state, "position"), "point")
    text(point, "x", x)
    text(point, "y", y)
    text(add(state, "orientation"), "exact", math.remainder(heading, math.tau))
    text(add(state, "time"), "exact", str(tick))
    text(add(state, "velocity"), "exact", speed)


def _add_problem(root: Element, recorded: Recorded) -> None:
    """Add the car's task: from where it begins, to be beyond the crossing line within the scenario's horizon."""
    scenario = recorded.scenario
    found = add(root, "planningProblem", id=str(_PROBLEM))
    x, y, heading, speed = recorded.start
    ahead = 0.5 * (scenario.car.front - scenario.car.rear)
    state = add(found, "initialState")
    _fill(state, x + ahead * math.cos(heading), y + ahead * math.sin(heading), heading, speed, 0)
    for key in ("yawRate", "slipAngle"):
        text(add(state, key), "exact", 0.0)
    goal = add(found, "goalState")
    line = scenario.road.line
    along = float(right_and_along(line, np.array([[x, y]]))[0, 1])
    x, y, heading = road_pose(line, max(_GOAL, along + _GOAL))
    box = add(add(goal, "position"), "rectangle")
    text(box, "length", _GOAL)
    text(box, "width", scenario.road.lane_width)
    text(box, "orientation", math.remainder(heading, math.tau))
    middle = add(box, "center")
    text(middle, "x", x)
    text(middle, "y", y)
    time = add(goal, "time")
    text(time, "intervalStart", "1")
    text(time, "intervalEnd", str(max(2, scenario.ticks)))
