"""Writes episodes as ASAM OpenSCENARIO XML 1.2 or CommonRoad XML 2020a, and roads as ASAM OpenDRIVE 1.8.

OpenSCENARIO: everybody on a polyline with a time at each vertex. An entity's origin is SKD's reference point; its
bounding box says where the body is around it. Vertices are the states at ticks and that at the contact.

OpenDRIVE: the reference line is the middle of the car's lane. A lane offset moves the lanes' zero to the left edge of
those that go the car's way, so that these have ids −1, −2, … from left to right, and those to their left 1, 2, ….
Lanes elsewhere are roads of their own, which cross the first without a junction.

CommonRoad: states at whole ticks, so the last state of a kamikaze is that of the tick in which the contact was. An
object's position is the middle of its shape. The planning problem is the car's: from where it begins, along its lane.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.inputs.files import one_line
from skd_sim.scenario.road import ONCOMING, Road, right_and_along, road_curvature, road_pose
from skd_sim.scenario.road_user import CAR, height_of
from skd_sim.scenario.scenario import Scenario

from skd_evaluator.extensions.exchange.scene import EGO, ROAD_FILE, Actor, ExportedEpisode, stretch


def number(value: float) -> str:
    """Return the shortest text that is read back as a number is, without an exponent, which decimals of XML lack."""
    return str(np.format_float_positional(float(value), trim="0"))


def add(parent: Element, tag: str, **attributes: str | float) -> Element:
    """Add an element with attributes, numbers among them, and return it."""
    texts = {key: one if isinstance(one, str) else number(one) for key, one in attributes.items()}
    return SubElement(parent, tag, texts)


def text(parent: Element, tag: str, content: str | float) -> Element:
    """Add an element that holds a text or a number, and return it."""
    found = SubElement(parent, tag)
    found.text = content if isinstance(content, str) else number(content)
    return found


def as_bytes(root: Element) -> bytes:
    """Return a document in UTF-8."""
    indent(root)
    return bytes(tostring(root, encoding="UTF-8", xml_declaration=True)) + b"\n"


MINOR = 8
"""Of version 1.8, the first in which a lane can say that it is driven the other way."""


def write_road(path: Path, recorded: Sequence[ExportedEpisode]) -> None:
    """Write the road on which some episodes of one scenario are, as long as they need it."""
    path.write_bytes(as_bytes(opendrive(recorded[0].scenario, recorded)))


def opendrive(scenario: Scenario, recorded: Sequence[ExportedEpisode]) -> Element:
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


_ON_FOOT = "pedestrian"
"""Word of OpenSCENARIO for who is no vehicle."""
_WEIGHT, _CAR_WEIGHT = 75.0, 1500.0  # kg, of which SKD knows nothing: a person's, a car's
_NOTHING = 0.0


def write_openscenario(path: Path, recorded: ExportedEpisode) -> None:
    """Write an episode; its road is in the file `ROAD_FILE` beside it."""
    path.write_bytes(as_bytes(openscenario(recorded)))


def openscenario(recorded: ExportedEpisode) -> Element:
    """Return an episode as a document."""
    root = Element("OpenSCENARIO")
    add(
        root, "FileHeader", revMajor="1", revMinor="2", date=recorded.date, author="SKD", description=recorded.title
    )  # fmt: skip
    add(root, "ParameterDeclarations")
    add(root, "CatalogLocations")
    add(add(root, "RoadNetwork"), "LogicFile", filepath=ROAD_FILE)
    entities = add(root, "Entities")
    if recorded.ego is None:
        _add_car(entities, recorded.scenario)
    for actor in recorded.actors:
        _add_entity(entities, actor, recorded.scenario)
    board = add(root, "Storyboard")
    begin = add(add(board, "Init"), "Actions")
    if recorded.ego is None:
        _add_start(begin, EGO, *recorded.start)
    for actor in recorded.actors:
        x, y, heading, speed = actor.states[0].tolist()
        _add_start(begin, actor.name, x, y, heading, speed, moves=not actor.is_obstacle)
    moving = [actor for actor in recorded.actors if not actor.stands]
    if moving:
        act = add(add(board, "Story", name="Story"), "Act", name="Act")
        for actor in moving:
            _add_way(act, actor)
        _add_trigger(act, "StartTrigger", "begin", 0.0)
    _add_trigger(board, "StopTrigger", "end", recorded.duration)
    return root


def _add_entity(entities: Element, actor: Actor, scenario: Scenario) -> None:
    if actor.name == EGO:
        _add_car(entities, scenario)
        return
    found = add(entities, "ScenarioObject", name=actor.name)
    if actor.is_obstacle:
        body = add(found, "MiscObject", name=actor.name, miscObjectCategory="obstacle", mass=_CAR_WEIGHT)
        _add_box(body, actor.size, actor.centre)
    elif (word := actor.word("openscenario")) == _ON_FOOT:
        body = add(found, "Pedestrian", name=actor.name, pedestrianCategory=word, mass=_WEIGHT)
        _add_box(body, actor.size, actor.centre)
    else:
        body = _add_vehicle(found, actor.name, word, actor.size, actor.centre)
    kind = "obstacle" if actor.body is None else actor.body.kind
    add(add(body, "Properties"), "Property", name="skd.kind", value=kind)


def _add_car(entities: Element, scenario: Scenario) -> None:
    """Add the car under test as the scenario describes it; another one may be driven in its place."""
    car = scenario.car
    found = add(entities, "ScenarioObject", name=EGO)
    size = (car.front + car.rear, car.width, height_of(CAR))
    add(_add_vehicle(found, EGO, "car", size, 0.5 * (car.front - car.rear)), "Properties")


def _add_vehicle(parent: Element, name: str, category: str, size: tuple[float, float, float], centre: float) -> Element:
    """Add a vehicle; its axles are where those of most are, a fifth of its length from its ends."""
    length, width, _ = size
    vehicle = add(parent, "Vehicle", name=name, vehicleCategory=category)
    _add_box(vehicle, size, centre)
    add(vehicle, "Performance", maxSpeed=70.0, maxAcceleration=10.0, maxDeceleration=15.0)
    axles = add(vehicle, "Axles")
    wheel = min(0.65, 0.3 * length)
    shared = {"trackWidth": 0.85 * width, "wheelDiameter": wheel, "positionZ": 0.5 * wheel}
    add(axles, "FrontAxle", maxSteering=0.6, positionX=centre + 0.3 * length, **shared)
    add(axles, "RearAxle", maxSteering=_NOTHING, positionX=centre - 0.3 * length, **shared)
    return vehicle


def _add_box(body: Element, size: tuple[float, float, float], centre: float) -> None:
    box, (length, width, height) = add(body, "BoundingBox"), size
    add(box, "Center", x=centre, y=_NOTHING, z=0.5 * height)
    add(box, "Dimensions", length=length, width=width, height=height)


def _add_start(
    begin: Element, name: str, x: float, y: float, heading: float, speed: float, *, moves: bool = True
) -> None:
    private = add(begin, "Private", entityRef=name)
    place = add(add(add(private, "PrivateAction"), "TeleportAction"), "Position")
    add(place, "WorldPosition", x=x, y=y, z=_NOTHING, h=heading)
    if moves:
        action = add(add(add(private, "PrivateAction"), "LongitudinalAction"), "SpeedAction")
        add(action, "SpeedActionDynamics", dynamicsShape="step", value=_NOTHING, dynamicsDimension="time")
        add(add(action, "SpeedActionTarget"), "AbsoluteTargetSpeed", value=speed)


def _add_way(act: Element, actor: Actor) -> None:
    group = add(act, "ManeuverGroup", name=f"way of {actor.name}", maximumExecutionCount="1")
    add(add(group, "Actors", selectTriggeringEntities="false"), "EntityRef", entityRef=actor.name)
    event = add(
        add(group, "Maneuver", name=f"maneuver of {actor.name}"),
        "Event", name=f"event of {actor.name}", priority="override", maximumExecutionCount="1",
    )  # fmt: skip
    action = add(add(event, "Action", name=f"follow {actor.name}"), "PrivateAction")
    follow = add(add(action, "RoutingAction"), "FollowTrajectoryAction")
    trajectory = add(add(follow, "TrajectoryRef"), "Trajectory", name=f"trajectory of {actor.name}", closed="false")
    line = add(add(trajectory, "Shape"), "Polyline")
    for time, (x, y, heading, _) in zip(actor.times.tolist(), actor.states.tolist(), strict=True):
        place = add(add(line, "Vertex", time=time), "Position")
        add(place, "WorldPosition", x=x, y=y, z=_NOTHING, h=heading)
    add(add(follow, "TimeReference"), "Timing", domainAbsoluteRelative="absolute", scale=1.0, offset=_NOTHING)
    add(follow, "TrajectoryFollowingMode", followingMode="position")
    _add_trigger(event, "StartTrigger", f"begin of {actor.name}", 0.0)


def _add_trigger(parent: Element, tag: str, name: str, time: float) -> None:
    condition = add(
        add(add(parent, tag), "ConditionGroup"), "Condition", name=name, delay=_NOTHING, conditionEdge="none"
    )
    add(add(condition, "ByValueCondition"), "SimulationTimeCondition", value=time, rule="greaterOrEqual")


_FIRST_LANELET = 10_001
_PROBLEM = 20_001
_GOAL = 20.0  # m behind the crossing line, and so long


def write_commonroad(path: Path, recorded: ExportedEpisode) -> None:
    """Write an episode."""
    path.write_bytes(as_bytes(commonroad(recorded)))


def commonroad(recorded: ExportedEpisode) -> Element:
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


def _add_lanelets(root: Element, recorded: ExportedEpisode) -> None:
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
    text(found, "type", parked if actor.stands else actor.word("commonroad"))
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


def _add_problem(root: Element, recorded: ExportedEpisode) -> None:
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
