"""An episode as ASAM OpenSCENARIO XML 1.2: everybody on a polyline with a time at each vertex, on an OpenDRIVE road.

An entity's origin is SKD's reference point; its bounding box says where the body is around it. Vertices are the states
at ticks and that at the contact, between which everybody moves uniformly, as here.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element

from skd_sim.scenario.kinds import CAR, height_of
from skd_sim.scenario.scenario import Scenario

from skd_evaluator.extensions.exchange.going_out.recorded import Actor, Recorded
from skd_evaluator.extensions.exchange.going_out.xml_text import add, as_bytes
from skd_evaluator.extensions.exchange.names import EGO, ROAD_FILE

_FORMAT = "openscenario"
_ON_FOOT = "pedestrian"
"""Word of OpenSCENARIO for who is no vehicle."""
_WEIGHT, _CAR_WEIGHT = 75.0, 1500.0  # kg, of which SKD knows nothing: a person's, a car's
_NOTHING = 0.0


def write_openscenario(path: Path, recorded: Recorded) -> None:
    """Write an episode; its road is in the file `ROAD_FILE` beside it."""
    path.write_bytes(as_bytes(openscenario(recorded)))


def openscenario(recorded: Recorded) -> Element:
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
    elif (word := actor.word(_FORMAT)) == _ON_FOOT:
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
