"""Writes episodes as ASAM OpenSCENARIO XML 1.2 or CommonRoad XML 2020a, and roads as ASAM OpenDRIVE 1.8.

OpenSCENARIO: road users on polylines with a time at each vertex. An entity's origin is SKD's reference point; its
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
from xml.etree.ElementTree import Element, indent, tostring

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.inputs.files import one_line
from skd_sim.scenario.road import ONCOMING, Road, right_and_along, road_curvature, road_pose
from skd_sim.scenario.road_user import CAR, height_of
from skd_sim.scenario.scenario import Scenario

from skd_evaluator.extensions.exchange.scene import EGO, ROAD_FILE, Actor, ExportedEpisode, lanes_of, stretch


def number(value: float) -> str:
    """Return the shortest text that is read back as a number is, without an exponent, which decimals of XML lack."""
    return str(np.format_float_positional(float(value), trim="0"))


def element(tag: str, *content: Element | str | float, **attributes: str | float) -> Element:
    """Return an element with attributes, and with a text, a number or other elements in it."""
    found = Element(tag, {key: one if isinstance(one, str) else number(one) for key, one in attributes.items()})
    for one in content:
        if isinstance(one, Element):
            found.append(one)
        else:
            found.text = one if isinstance(one, str) else number(one)
    return found


def _write(path: Path, root: Element) -> None:
    """Write a document in UTF-8."""
    indent(root)
    path.write_bytes(tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n")


# --- OpenDRIVE

MINOR = "8"
"""Of version 1.8, the first in which a lane can say that it is driven the other way."""


def write_road(path: Path, recorded: Sequence[ExportedEpisode]) -> None:
    """Write the road on which some episodes of one scenario are, as long as they need it."""
    _write(path, opendrive(recorded[0].scenario, recorded))


def opendrive(scenario: Scenario, recorded: Sequence[ExportedEpisode]) -> Element:
    """Return the road of a scenario, as far as some episodes need it."""
    road, date = scenario.road, recorded[0].date
    header = element(
        "header", revMajor="1", revMinor=MINOR, name=one_line(scenario.name), version="1.00", date=date
    )  # fmt: skip
    beside = sorted(number for number, lane in road.every_lane.items() if lane.beside)
    elsewhere = [number for number, lane in road.every_lane.items() if not lane.beside]
    roads = [_road(road, 0, beside, stretch(scenario, recorded))]
    roads += [_road(road, at + 1, [one], stretch(scenario, recorded, one)) for at, one in enumerate(elsewhere)]
    return element("OpenDRIVE", header, *roads)


def _road(road: Road, number: int, lanes: Sequence[int], span: tuple[float, float]) -> Element:
    """Return a road with lanes, by their numbers from left to right, between two path coordinates, m."""
    low, high = span
    line, plan = road.line_of(lanes[0]), []
    for begin, end, curvature in _pieces(line, low, high):
        x, y, heading = road_pose(line, begin)
        shape = element("arc", curvature=curvature) if curvature else element("line")
        plan.append(element("geometry", shape, s=begin - low, x=x, y=y, hdg=heading, length=end - begin))
    runs = {one: road.every_lane[one].direction != ONCOMING for one in lanes}
    left = [one for one in lanes if one < 0 and not all(runs[other] for other in lanes if one <= other < 0)]
    right = [one for one in lanes if one not in left]
    edge = road.offset(right[0]) - 0.5 * road.width(right[0])  # to the right of the reference line
    centre = element("lane", _mark("broken" if left else "solid"), id="0", type="none", level="false")
    sides = [element("center", centre)]
    if left:
        those = (_lane(road, one, len(left) - place, runs_along=runs[one]) for place, one in enumerate(left))
        sides.insert(0, element("left", *those))
    sides.append(
        element("right", *(_lane(road, one, -1 - place, runs_along=runs[one]) for place, one in enumerate(right)))
    )
    section = element("laneSection", *sides, s=0.0)
    every = element("lanes", element("laneOffset", s=0.0, a=-edge, b=0.0, c=0.0, d=0.0), section)
    about = {"name": f"road {number}", "id": str(number), "junction": "-1", "rule": "RHT"}
    kind = element("type", s=0.0, type="town")
    return element("road", kind, element("planView", *plan), every, length=high - low, **about)


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


def _lane(road: Road, lane: int, number: int, *, runs_along: bool) -> Element:
    """Return a lane. Those on the right run along the reference line, those on the left against it."""
    width = element("width", sOffset=0.0, a=road.width(lane), b=0.0, c=0.0, d=0.0)
    against = {"direction": "reversed"} if runs_along != (number < 0) else {}
    return element("lane", width, _mark("solid"), id=str(number), type="driving", level="false", **against)


def _mark(kind: str) -> Element:
    return element("roadMark", sOffset=0.0, type=kind, weight="standard", color="standard", width=0.12,
                   laneChange="both")  # fmt: skip


# --- OpenSCENARIO

_ON_FOOT = "pedestrian"
"""Word of OpenSCENARIO for who is no vehicle."""
_WEIGHT, _CAR_WEIGHT = 75.0, 1500.0  # kg, of which SKD knows nothing: a person's, a car's


def write_openscenario(path: Path, recorded: ExportedEpisode) -> None:
    """Write an episode; its road is in the file `ROAD_FILE` beside it."""
    _write(path, openscenario(recorded))


def openscenario(recorded: ExportedEpisode) -> Element:
    """Return an episode as a document."""
    entities = [_entity(actor, recorded.scenario) for actor in recorded.actors]
    begin = [_start(one.name, *one.states[0].tolist(), moves=not one.is_obstacle) for one in recorded.actors]
    if recorded.ego is None:
        entities.insert(0, _car(recorded.scenario))
        begin.insert(0, _start(EGO, *recorded.start))
    moving = [_way(actor) for actor in recorded.actors if not actor.stands]
    board = [element("Init", element("Actions", *begin))]
    if moving:
        act = element("Act", *moving, _trigger("StartTrigger", "begin"), name="Act")
        board.append(element("Story", act, name="Story"))
    about = {"date": recorded.date, "author": "SKD", "description": recorded.title}
    return element(
        "OpenSCENARIO",
        element("FileHeader", revMajor="1", revMinor="2", **about),
        element("ParameterDeclarations"),
        element("CatalogLocations"),
        element("RoadNetwork", element("LogicFile", filepath=ROAD_FILE)),
        element("Entities", *entities),
        element("Storyboard", *board, _trigger("StopTrigger", "end", recorded.duration)),
    )


def _entity(actor: Actor, scenario: Scenario) -> Element:
    if actor.name == EGO:
        return _car(scenario)
    kind = "obstacle" if actor.body is None else actor.body.kind
    further = element("Properties", element("Property", name="skd.kind", value=kind))
    box, word = _box(actor.size, actor.centre), "" if actor.is_obstacle else actor.word("openscenario")
    if actor.is_obstacle:
        body = element("MiscObject", box, further, name=actor.name, miscObjectCategory="obstacle", mass=_CAR_WEIGHT)
    elif word == _ON_FOOT:
        body = element("Pedestrian", box, further, name=actor.name, pedestrianCategory=word, mass=_WEIGHT)
    else:
        body = _vehicle(actor.name, word, actor.size, actor.centre, further)
    return element("ScenarioObject", body, name=actor.name)


def _car(scenario: Scenario) -> Element:
    """Return the car under test as the scenario describes it; another one may be driven in its place."""
    car = scenario.car
    size = (car.front + car.rear, car.width, height_of(CAR))
    body = _vehicle(EGO, "car", size, 0.5 * (car.front - car.rear), element("Properties"))
    return element("ScenarioObject", body, name=EGO)


def _vehicle(name: str, category: str, size: tuple[float, float, float], centre: float, further: Element) -> Element:
    """Return a vehicle; its axles are where those of most are, a fifth of its length from its ends."""
    length, width, _ = size
    wheel = min(0.65, 0.3 * length)
    shared = {"trackWidth": 0.85 * width, "wheelDiameter": wheel, "positionZ": 0.5 * wheel}
    front = element("FrontAxle", maxSteering=0.6, positionX=centre + 0.3 * length, **shared)
    rear = element("RearAxle", maxSteering=0.0, positionX=centre - 0.3 * length, **shared)
    limits = element("Performance", maxSpeed=70.0, maxAcceleration=10.0, maxDeceleration=15.0)
    axles = element("Axles", front, rear)
    return element("Vehicle", _box(size, centre), limits, axles, further, name=name, vehicleCategory=category)


def _box(size: tuple[float, float, float], centre: float) -> Element:
    length, width, height = size
    middle = element("Center", x=centre, y=0.0, z=0.5 * height)
    return element("BoundingBox", middle, element("Dimensions", length=length, width=width, height=height))


def _start(name: str, x: float, y: float, heading: float, speed: float, *, moves: bool = True) -> Element:
    actions = [element("PrivateAction", element("TeleportAction", _position(x, y, heading)))]
    if moves:
        at_once = element("SpeedActionDynamics", dynamicsShape="step", value=0.0, dynamicsDimension="time")
        target = element("SpeedActionTarget", element("AbsoluteTargetSpeed", value=speed))
        action = element("LongitudinalAction", element("SpeedAction", at_once, target))
        actions.append(element("PrivateAction", action))
    return element("Private", *actions, entityRef=name)


def _position(x: float, y: float, heading: float) -> Element:
    return element("Position", element("WorldPosition", x=x, y=y, z=0.0, h=heading))


def _way(actor: Actor) -> Element:
    """Return the maneuver of an actor that follows its positions, with a time at each."""
    name, once = actor.name, {"maximumExecutionCount": "1"}
    rows = zip(actor.times.tolist(), actor.states[:, :3].tolist(), strict=True)
    line = element("Polyline", *(element("Vertex", _position(*pose), time=time) for time, pose in rows))
    trajectory = element("Trajectory", element("Shape", line), name=f"trajectory of {name}", closed="false")
    timing = element("Timing", domainAbsoluteRelative="absolute", scale=1.0, offset=0.0)
    reference = element("TrajectoryRef", trajectory), element("TimeReference", timing)
    mode = element("TrajectoryFollowingMode", followingMode="position")
    private = element("PrivateAction", element("RoutingAction", element("FollowTrajectoryAction", *reference, mode)))
    action, trigger = element("Action", private, name=f"follow {name}"), _trigger("StartTrigger", f"begin of {name}")
    event = element("Event", action, trigger, name=f"event of {name}", priority="override", **once)
    maneuver = element("Maneuver", event, name=f"maneuver of {name}")
    actors = element("Actors", element("EntityRef", entityRef=name), selectTriggeringEntities="false")
    return element("ManeuverGroup", actors, maneuver, name=f"way of {name}", **once)


def _trigger(tag: str, name: str, time: float = 0.0) -> Element:
    after = element("ByValueCondition", element("SimulationTimeCondition", value=time, rule="greaterOrEqual"))
    condition = element("Condition", after, name=name, delay=0.0, conditionEdge="none")
    return element(tag, element("ConditionGroup", condition))


# --- CommonRoad

_FIRST_LANELET = 10_001
_PROBLEM = 20_001
_GOAL = 20.0  # m behind the crossing line, and so long


def write_commonroad(path: Path, recorded: ExportedEpisode) -> None:
    """Write an episode."""
    _write(path, commonroad(recorded))


def commonroad(recorded: ExportedEpisode) -> Element:
    """Return an episode as a document."""
    name = "".join(one for one in recorded.scenario.name.title() if one.isascii() and one.isalnum()) or "Skd"
    step = recorded.scenario.time_step
    return element(
        "commonRoad",
        _texts("location", geoNameId="-999", gpsLatitude="999", gpsLongitude="999"),
        element("scenarioTags", element("simulated")),
        *_lanelets(recorded),
        *(_object(actor, step) for actor in sorted(recorded.actors, key=lambda one: not one.stands)),
        _problem(recorded),
        commonRoadVersion="2020a", benchmarkID=f"ZAM_{name}-1_1_T-1", date=recorded.date[:10], author="SKD",
        affiliation="SKD", source=recorded.title, timeStepSize=step,
    )  # fmt: skip


def _texts(tag: str, *further: Element, **content: str | float) -> Element:
    """Return an element with elements that have one text or number each."""
    return element(tag, *(element(key, one) for key, one in content.items()), *further)


def _lanelets(recorded: ExportedEpisode) -> list[Element]:
    every, found = lanes_of(recorded), []
    ids = {lane.number: str(_FIRST_LANELET + index) for index, lane in enumerate(every)}
    directions = {number: lane.direction for number, lane in recorded.scenario.road.every_lane.items()}
    for lane in every:
        bounds = (
            element(tag, *(_texts("point", x=x, y=y) for x, y in edge.tolist()))
            for tag, edge in (("leftBound", lane.left), ("rightBound", lane.right))
        )
        beside = (
            element(tag, ref=ids[other],
                    drivingDir="same" if directions[other] == directions[lane.number] else "opposite")
            for tag, other in zip(("adjacentLeft", "adjacentRight"), lane.beside, strict=True)
            if other is not None
        )  # fmt: skip
        found.append(element("lanelet", *bounds, *beside, element("laneletType", "urban"), id=ids[lane.number]))
    return found


def _object(actor: Actor, step: float) -> Element:
    """Return an object; one that stands is static."""
    is_disc = actor.body is not None and not actor.body.is_box
    length, width, _ = actor.size
    shape = _texts("circle", radius=0.5 * length) if is_disc else _texts("rectangle", length=length, width=width)
    rows = np.column_stack([actor.centres, actor.states[:, 2:], np.rint(actor.times / step)]).tolist()
    first, *rest = (_state("state" if row[-1] else "initialState", row) for row in rows)
    still = "unknown" if actor.body is None or is_disc else "parkedVehicle"
    found = [element("type", still if actor.stands else actor.word("commonroad")), element("shape", shape), first]
    if rest:
        found.append(element("trajectory", *rest))
    return element("staticObstacle" if actor.stands else "dynamicObstacle", *found, id=str(actor.number))


def _state(tag: str, row: Sequence[float], **further: float) -> Element:
    """Return a state of x, y (m), heading (rad), speed (m/s) and time step."""
    x, y, heading, speed, tick = row
    said: dict[str, str | float] = {
        "orientation": math.remainder(heading, math.tau),
        "time": str(int(tick)),
        "velocity": speed,
        **further,
    }
    exact = (_texts(key, exact=value) for key, value in said.items())
    return element(tag, element("position", _texts("point", x=x, y=y)), *exact)


def _problem(recorded: ExportedEpisode) -> Element:
    """Return the car's task: from where it begins, to be beyond the crossing line within the scenario's horizon."""
    scenario = recorded.scenario
    x, y, heading, speed = recorded.start
    ahead = 0.5 * (scenario.car.front - scenario.car.rear)
    place = x + ahead * math.cos(heading), y + ahead * math.sin(heading)
    along = float(right_and_along(scenario.road.line, np.array([[x, y]]))[0, 1])
    x, y, turned = road_pose(scenario.road.line, max(_GOAL, along + _GOAL))
    size = {"length": _GOAL, "width": scenario.road.lane_width, "orientation": math.remainder(turned, math.tau)}
    box = _texts("rectangle", _texts("center", x=x, y=y), **size)
    time = _texts("time", intervalStart="1", intervalEnd=str(max(2, scenario.ticks)))
    begin = _state("initialState", (*place, heading, speed, 0), yawRate=0.0, slipAngle=0.0)
    return element("planningProblem", begin, element("goalState", element("position", box), time), id=str(_PROBLEM))
