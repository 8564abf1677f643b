"""Finds the tracks of entities in ASAM OpenSCENARIO XML 1.0 to 1.3, as far as a file says them without a simulation.

Read are trajectories (polylines, clothoids, NURBS) with times, or followed at one speed. Positions are those of the
world, or of lanes and roads on straight lines and arcs of the file's OpenDRIVE. Declared parameters and expressions are
put in. The y of a file for CARLA, which points right, is turned over.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from scipy.integrate import cumulative_simpson
from scipy.interpolate import BSpline
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.inputs.files import finite_number, is_there, read_xml

from skd_evaluator.bags.tracks import Listed, Track

OPENSCENARIO = "OpenSCENARIO"
STANDS = "no action"
"""Form of an entity that nothing in the file moves."""
_CARLA = "CARLA:"
_SAMPLES = 400  # places along a curve
_READ = "trajectories with times, or followed at one speed"


def read_openscenario(root: Element, path: Path) -> list[Track | Listed]:
    """Return every entity: its track, or why it has none that is read.

    Args:
        root: root of the document; parameters are put into it.
        path: the file, beside which its OpenDRIVE is.
    """
    _put_in_parameters(root)
    header = root.find("FileHeader")
    flips = header is not None and header.get("description", "").startswith(_CARLA)
    places = _Places(root, path)
    found: list[Track | Listed] = []
    entities = {one.get("name", ""): one for one in root.iter("ScenarioObject")}
    refs = [one.get("entityRef", "") for tag in ("EntityRef", "Private") for one in root.iter(tag)]
    for name in dict.fromkeys((*entities, *refs)):
        entity = entities.get(name, Element("none"))
        follows, others = _actions_of(root, name)
        form = _form(follows, others)
        try:
            track = _track(name, follows, others, places, f"{path}, {name}")
        except UsageError as error:
            found.append(Listed(name, form, 0, np.zeros(0), why=str(error).removeprefix(f"{path}, {name}: ")))
            continue
        notes = ("y turned over, for CARLA's points right",) if flips else ()
        found.append(
            replace(track, places=track.places * [1.0, -1.0 if flips else 1.0], kind=_kind(entity), notes=notes)
        )
    return found


def _actions_of(root: Element, name: str) -> tuple[list[Element], list[Element]]:
    """Return what an entity follows, and its other actions."""
    private = [one for one in root.iter("Private") if one.get("entityRef") == name]
    for group in root.iter("ManeuverGroup"):
        if name in [one.get("entityRef") for one in group.findall("Actors/EntityRef")]:
            private.append(group)
    follows = [one for inside in private for one in inside.iter("FollowTrajectoryAction")]
    actions = (one for inside in private for action in inside.iter("PrivateAction") for one in action)
    return follows, [one for one in actions if one.find("FollowTrajectoryAction") is None]


def _form(follows: list[Element], others: list[Element]) -> str:
    """Return by what an entity moves, in the words of the format."""
    if follows:
        return " and ".join(dict.fromkeys(_shape(one)[0] for one in follows))
    inner = (one for action in others for one in action if action.tag != "TeleportAction")
    return " and ".join(dict.fromkeys(one.tag for one in inner)) or STANDS


def _shape(follow: Element) -> tuple[str, Element | None]:
    """Return kind and element of the shape that is followed."""
    shape = next(follow.iter("Shape"), None)
    if shape is None or not len(shape):
        return ("trajectory of a catalogue" if follow.find(".//CatalogReference") is not None else "no shape"), None
    return shape[0].tag, shape[0]


def _track(name: str, follows: list[Element], others: list[Element], places: _Places, where: str) -> Track:
    form = _form(follows, others)
    if len(follows) > 1:
        raise UsageError(f"{where}: follows two trajectories; give a file in which it follows one")
    if not follows:
        raise UsageError(
            f"{where}: {f'moves by {form}' if others else 'nothing in the file moves it'}; read are {_READ}"
        )
    unknown = next((text for one in follows[0].iter() for text in one.attrib.values() if "$" in text), None)
    if unknown is not None:
        raise UsageError(f"{where}: the parameter {unknown[:40]!r} is not declared, or in two ways")
    offset = follows[0].get("initialDistanceOffset", "0")
    if finite_number(offset, f"{where}: initialDistanceOffset") != 0.0:
        raise UsageError(f"{where}: begins within its trajectory (initialDistanceOffset), whose times do not")
    kind, shape = _shape(follows[0])
    line = {"Polyline": _polyline, "Clothoid": _clothoid, "Nurbs": _nurbs}.get(kind)
    if line is None or shape is None:
        raise UsageError(f"{where}: follows a {kind}, which is not read; read are {_READ}")
    rows = line(shape, places, where)
    timing = follows[0].find("TimeReference/Timing")
    if timing is not None and np.isnan(rows[:, 0]).any():
        raise UsageError(f"{where}: a vertex has no time, so nothing says when it is there")
    if timing is not None:
        scale, start = (finite_number(timing.get(key, ""), f"{where}: {key} of Timing") for key in ("scale", "offset"))
        if not 1e-6 < scale < 1e6:
            raise UsageError(f"{where}: scale of Timing must be above 0, got {scale:g}")
        rows[:, 0] = rows[:, 0] * scale + start
    else:
        speed = _one_speed(others)
        if speed is None:
            raise UsageError(
                f"{where}: its {kind} is followed without times (TimeReference), and not at one speed: nothing says "
                "when it is where"
            )
        rows[:, 0] = np.append(0.0, np.cumsum(np.hypot(*np.diff(rows[:, 1:], axis=0).T))) / speed
        form = f"{form} at {speed:g} m/s"
    return Track.of_rows(rows, where, name, form=form, drawn=True)


def _one_speed(others: list[Element]) -> float | None:
    """Return the speed (m/s) that an entity is given at once, and once; None without."""
    speeds = [one for action in others for one in action.iter("SpeedAction")]
    if len(speeds) != 1:
        return None
    dynamics, target = speeds[0].find("SpeedActionDynamics"), speeds[0].find(".//AbsoluteTargetSpeed")
    at_once = dynamics is not None and (
        dynamics.get("dynamicsShape") == "step" or _number_or_none(dynamics.get("value")) == 0.0
    )
    speed = None if target is None else _number_or_none(target.get("value"))
    return speed if at_once and speed else None


def _number_or_none(text: str | None) -> float | None:
    try:
        return finite_number(text or "", "")
    except UsageError:
        return None


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


# --- shapes: time (s, nan where there is none), x, y


def _polyline(shape: Element, places: _Places, where: str) -> FloatArray:
    return _points(shape.findall("Vertex"), places, where)


def _points(elements: list[Element], places: _Places, where: str) -> FloatArray:
    """Return time, x and y of vertices or control points, n × 3."""
    rows = []
    for one in elements:
        time = one.get("time")
        x, y = places.at(one.find("Position"), where)
        rows.append((math.nan if time is None else finite_number(time, f"{where}: time of a vertex"), x, y))
    return np.array(rows, np.float64).reshape(-1, 3)


def _nurbs(shape: Element, places: _Places, where: str) -> FloatArray:
    """Return places along a rational B-spline; its control points' times are a dimension like x and y."""
    points = _points(shape.findall("ControlPoint"), places, where)
    weights = np.array(
        [finite_number(one.get("weight", "1"), f"{where}: weight") for one in shape.findall("ControlPoint")]
    )
    knots = np.array([finite_number(one.get("value", ""), f"{where}: knot") for one in shape.findall("Knot")])
    order = int(finite_number(shape.get("order", ""), f"{where}: order"))
    if order < 2 or len(points) < order or len(knots) != len(points) + order or (np.diff(knots) < 0.0).any():
        raise UsageError(
            f"{where}: follows a NURBS of order {order} with {len(points)} control points and {len(knots)} knots; as "
            "many points as its order, and knots for both, are needed"
        )
    if (weights <= 0.0).any() or knots[order - 1] >= knots[len(points)]:
        raise UsageError(f"{where}: follows a NURBS with weights or knots that must be above others")
    spline = BSpline(knots, np.column_stack([points, np.ones(len(points))]) * weights[:, None], order - 1)
    at = np.linspace(knots[order - 1], knots[len(points)], _SAMPLES + 1)
    at[-1] = np.nextafter(at[-1], -math.inf)
    found = spline(at)
    return np.asarray(found[:, :3] / found[:, 3:])


def _clothoid(shape: Element, places: _Places, where: str) -> FloatArray:
    """Return places along a clothoid, and its times, which pass as its length does."""
    prime = shape.get("curvaturePrime", shape.get("curvatureDot", ""))
    bend, change, length = (
        finite_number(text, f"{where}: {key} of a clothoid")
        for key, text in (
            ("curvature", shape.get("curvature", "")),
            ("curvaturePrime", prime),
            ("length", shape.get("length", "")),
        )
    )
    position = shape.find("Position")
    world = None if position is None else position.find("WorldPosition")
    if world is None:
        raise UsageError(f"{where}: its clothoid does not begin at a WorldPosition")
    x, y = places.at(position, where)
    along = np.linspace(0.0, length, _SAMPLES + 1)
    heading = finite_number(world.get("h", "0"), f"{where}: h") + bend * along + 0.5 * change * along**2
    moved = [cumulative_simpson(one(heading), x=along, initial=0.0) for one in (np.cos, np.sin)]
    begin, end = (_number_or_none(shape.get(key)) for key in ("startTime", "stopTime"))
    times = np.full(len(along), math.nan)
    if begin is not None and end is not None:
        times = begin + (end - begin) * along / length
    return np.column_stack([times, x + moved[0], y + moved[1]])


# --- positions


class _Places:
    """Where positions are in the world."""

    def __init__(self, root: Element, path: Path) -> None:
        logic = root.find("RoadNetwork/LogicFile")
        self._map = None if logic is None else path.parent / logic.get("filepath", "").replace("\\", "/")

    def at(self, position: Element | None, where: str) -> tuple[float, float]:
        """Return x and y of a position, m.

        Raises:
            UsageError: it is of a kind that is not read, or its road is not.
        """
        found = next(iter(position), None) if position is not None else None
        tag = "none" if found is None else found.tag
        if found is not None and tag == "WorldPosition":
            x, y = (finite_number(found.get(key, ""), f"{where}: {key} of a vertex") for key in ("x", "y"))
            return x, y
        if found is None or tag not in ("LanePosition", "RoadPosition"):
            raise UsageError(f"{where}: a vertex is at a {tag}, and read are WorldPosition, LanePosition, RoadPosition")
        if self._map is None or not is_there(self._map) or not self._map.is_file():
            file = "no file" if self._map is None else self._map.name
            raise UsageError(
                f"{where}: a vertex is at a {tag}, not at a WorldPosition, and its OpenDRIVE is {file} here"
            )
        road = _roads(self._map).get(found.get("roadId", ""))
        if road is None:
            raise UsageError(
                f"{where}: a vertex is on road {found.get('roadId')!r}, which {self._map.name} does not have"
            )
        s, t, lane, offset = (
            finite_number(found.get(key, "0"), f"{where}: {key}") for key in ("s", "t", "laneId", "offset")
        )
        t = t if tag == "RoadPosition" else _lane_centre(road, s, lane, where) + offset
        return _on_road(road, s, t, where)


@cache
def _roads(path: Path) -> dict[str, Element]:
    return {one.get("id", ""): one for one in read_xml(path).iter("road")}


def _value(element: Element, key: str) -> float:
    return finite_number(element.get(key, ""), f"OpenDRIVE: {key} of {element.tag}")


def _last_before(elements: list[Element], key: str, s: float) -> Element | None:
    return max(
        (one for one in elements if _value(one, key) <= s + 1e-9), key=lambda one: _value(one, key), default=None
    )


def _cubic(element: Element | None, key: str, s: float) -> float:
    if element is None:
        return 0.0
    ds = s - _value(element, key)
    return sum(_value(element, name) * ds**power for power, name in enumerate("abcd"))


def _lane_centre(road: Element, s: float, lane: float, where: str) -> float:
    """Return the offset of a lane's middle from the reference line, m, to the left."""
    offset = _cubic(_last_before(road.findall("lanes/laneOffset"), "s", s), "s", s)
    section = _last_before(road.findall("lanes/laneSection"), "s", s)
    side = "left" if lane > 0 else "right"
    lanes = [] if section is None else section.findall(f"{side}/lane")
    widths = {
        int(_value(one, "id")): _cubic(
            _last_before(one.findall("width"), "sOffset", s - _value(section, "s")), "sOffset", s - _value(section, "s")
        )
        for one in lanes
        if section is not None
    }
    if lane and int(lane) not in widths:
        raise UsageError(f"{where}: a vertex is on lane {lane:g} of road {road.get('id')!r}, which it does not have")
    inner = sum(width for number, width in widths.items() if abs(number) < abs(lane))
    return offset + math.copysign(inner + 0.5 * widths[int(lane)], lane) if lane else offset


def _on_road(road: Element, s: float, t: float, where: str) -> tuple[float, float]:
    """Return x and y of a place by its path coordinates, m."""
    piece = _last_before(road.findall("planView/geometry"), "s", s)
    shape = None if piece is None or not len(piece) else piece[0]
    if piece is None or shape is None or shape.tag not in ("line", "arc") or s > _value(road, "length") + 1e-6:
        kind = "no geometry" if shape is None else f"a {shape.tag}"
        raise UsageError(f"{where}: a vertex is at {s:g} m of road {road.get('id')!r}, {kind}; read are lines and arcs")
    x, y, heading, ds = (*(_value(piece, key) for key in ("x", "y", "hdg")), s - _value(piece, "s"))
    bend = _value(shape, "curvature") if shape.tag == "arc" else 0.0
    turned = heading + bend * ds
    if bend:
        x += (math.sin(turned) - math.sin(heading)) / bend
        y += (math.cos(heading) - math.cos(turned)) / bend
    else:
        x, y = x + ds * math.cos(heading), y + ds * math.sin(heading)
    return x - t * math.sin(turned), y + t * math.cos(turned)


# --- parameters

_OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.Mod: operator.mod, ast.USub: operator.neg, ast.UAdd: operator.pos, ast.Not: operator.not_,
    ast.Eq: operator.eq, ast.NotEq: operator.ne, ast.Lt: operator.lt, ast.LtE: operator.le,
    ast.Gt: operator.gt, ast.GtE: operator.ge,
}  # fmt: skip
_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "round": round, "floor": math.floor, "ceil": math.ceil, "sqrt": math.sqrt, "pow": math.pow,
}  # fmt: skip


def _put_in_parameters(root: Element) -> None:
    """Write the values of declared parameters, and of expressions, in their place; others stay as they are."""
    declared: dict[str, str] = {}
    unsure: set[str] = set()
    for one in root.iter("ParameterDeclaration"):
        name, value = one.get("name", ""), _filled_in(one.get("value", ""), declared)
        if declared.setdefault(name, value) != value:
            unsure.add(name)
    for name in unsure:  # declared in two places with two values
        del declared[name]
    for element in root.iter():
        for key, text in element.attrib.items():
            if "$" in text:
                element.set(key, _filled_in(text, declared))


def _filled_in(text: str, declared: dict[str, str]) -> str:
    text = text.strip()
    if text.startswith("${") and text.endswith("}"):
        try:
            value = _computed(ast.parse(_names_out(text[2:-1], declared), mode="eval").body)
        except (SyntaxError, ValueError, TypeError, ArithmeticError, KeyError, AttributeError, RecursionError):
            return text
        return str(value).lower() if isinstance(value, bool) else value if isinstance(value, str) else repr(value)
    return declared.get(text[1:], text) if text.startswith("$") else text


def _names_out(text: str, declared: dict[str, str]) -> str:
    """Return an expression in which parameters are values; the longest names first."""
    for name in sorted(declared, key=len, reverse=True):
        value = declared[name]
        text = text.replace(f"${name}", f"({value})" if _number_or_none(value) is not None else repr(value))
    return text.replace("true", "True").replace("false", "False")


def _computed(node: ast.expr) -> Any:
    """Return the value of an expression of numbers, by the operators and functions of the standard."""
    if isinstance(node, ast.Constant):
        return node.value
    if isinstance(node, ast.UnaryOp):
        return _OPERATORS[type(node.op)](_computed(node.operand))
    if isinstance(node, ast.BinOp):
        return _OPERATORS[type(node.op)](_computed(node.left), _computed(node.right))
    if isinstance(node, ast.BoolOp):
        values = [bool(_computed(one)) for one in node.values]
        return all(values) if isinstance(node.op, ast.And) else any(values)
    if isinstance(node, ast.Compare):
        return _OPERATORS[type(node.ops[0])](_computed(node.left), _computed(node.comparators[0]))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        return _FUNCTIONS[node.func.id](*map(_computed, node.args))
    raise ValueError(ast.dump(node))
