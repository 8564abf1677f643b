"""Finds the tracks of entities in ASAM OpenSCENARIO XML 1.0 to 1.3, as far as a file says them without a simulation.

Read are trajectories (polylines, clothoids, NURBS) with times, or followed at one speed. Positions are those of the
world, or of lanes and roads on straight lines and arcs of the file's OpenDRIVE. Declared parameters and expressions are
put in. The y of a file for CARLA, which points right, is turned over.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from scipy.integrate import cumulative_simpson
from scipy.interpolate import BSpline
from skd_sim.errors import UsageError
from skd_sim.inputs.files import finite_number, is_there, read_xml
from skd_sim.world.state import FloatArray

from skd_evaluator.bags.tracks import Listed, Track, track_or_why

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
    is_carla = any(one.get("description", "").startswith(_CARLA) for one in root.findall("FileHeader"))
    logic = root.find("RoadNetwork/LogicFile")
    road_map = None if logic is None else path.parent / logic.get("filepath", "").replace("\\", "/")
    objects = {one.get("name", ""): one for one in root.iter("ScenarioObject")}
    refs = [one.get("entityRef", "") for tag in ("EntityRef", "Private") for one in root.iter(tag)]
    found: list[Track | Listed] = []
    for name in dict.fromkeys((*objects, *refs)):
        where = f"{path}, {name}"
        entity = _Entity(name, where, *_actions_of(root, name), road_map)
        track = track_or_why(where, name, entity.form, entity.track)
        if isinstance(track, Track):
            track = replace(track, kind=_kind(objects.get(name, Element("none"))))
            if is_carla:
                turned = track.places * [1.0, -1.0]
                track = replace(track, places=turned, notes=("y turned over, for CARLA's points right",))
        found.append(track)
    return found


def _actions_of(root: Element, name: str) -> tuple[list[Element], list[Element]]:
    """Return what an entity follows, and its other actions."""
    private = [one for one in root.iter("Private") if one.get("entityRef") == name]
    for group in root.iter("ManeuverGroup"):
        if name in [one.get("entityRef") for one in group.findall("Actors/EntityRef")]:
            private.append(group)
    actions = [one for inside in private for action in inside.iter("PrivateAction") for one in action]
    follows = [one for inside in private for one in inside.iter("FollowTrajectoryAction")]
    return follows, [one for one in actions if one.find("FollowTrajectoryAction") is None]


def _kind(entity: Element) -> str:
    """Return what an entity says it is: its own word for SKD, else its category."""
    said = [one.get("value", "") for one in entity.iter("Property") if one.get("name") == "skd.kind"]
    for body in entity:
        said += [one for one in (body.get("vehicleCategory"), body.get("pedestrianCategory")) if one]
    return said[0] if said else ""


@dataclass(frozen=True)
class _Entity:
    """An entity of a file.

    Attributes:
        name: of it.
        where: file and name, for messages.
        follows: trajectories that it follows.
        others: its other actions.
        road_map: the file's OpenDRIVE; None where it names none.
    """

    name: str
    where: str
    follows: Sequence[Element]
    others: Sequence[Element]
    road_map: Path | None

    @property
    def form(self) -> str:
        """By what it moves, in the words of the format."""
        if self.follows:
            return " and ".join(dict.fromkeys(_shape(one)[0] for one in self.follows))
        inner = (one for action in self.others for one in action if action.tag != "TeleportAction")
        return " and ".join(dict.fromkeys(one.tag for one in inner)) or STANDS

    def track(self) -> Track:
        """Return its track.

        Raises:
            UsageError: the file says none that is read.
        """
        if not self.follows:
            moved = f"moves by {self.form}" if self.others else "nothing in the file moves it"
            raise self._refused(f"{moved}; read are {_READ}")
        if len(self.follows) > 1:
            raise self._refused("follows two trajectories; give a file in which it follows one")
        follow, form = self.follows[0], self.form
        unknown = next((text for one in follow.iter() for text in one.attrib.values() if "$" in text), None)
        if unknown is not None:
            raise self._refused(f"the parameter {unknown[:40]!r} is not declared, or in two ways")
        if self._number(follow, "initialDistanceOffset", "0") != 0.0:
            raise self._refused("begins within its trajectory (initialDistanceOffset), whose times do not")
        kind, shape = _shape(follow)
        reader = {"Polyline": self._points, "Clothoid": self._clothoid, "Nurbs": self._nurbs}.get(kind)
        if reader is None or shape is None:
            raise self._refused(f"follows a {kind}, which is not read; read are {_READ}")
        rows, timing = reader(shape), follow.find("TimeReference/Timing")
        if timing is not None:
            if np.isnan(rows[:, 0]).any():
                raise self._refused("a vertex has no time, so nothing says when it is there")
            scale = self._number(timing, "scale")
            if not 1e-6 < scale < 1e6:
                raise self._refused(f"scale of Timing must be above 0, got {scale:g}")
            rows[:, 0] = rows[:, 0] * scale + self._number(timing, "offset")
        else:
            reached = self._speed()
            if reached is None:
                raise self._refused(f"its {kind} is followed without times (TimeReference), and not at one speed")
            (speed, rate), along = reached, np.append(0.0, np.cumsum(np.hypot(*np.diff(rows[:, 1:], axis=0).T)))
            start = 0.5 * speed**2 / rate  # m, from which on it has its speed
            rows[:, 0] = np.where(along < start, np.sqrt(2.0 * along / rate), speed / rate + (along - start) / speed)
            form = f"{form} at {speed:g} m/s"
        return Track.of_rows(rows, self.where, self.name, form=form, drawn=True)

    def _refused(self, why: str) -> UsageError:
        return UsageError(f"{self.where}: {why}")

    def _number(self, element: Element, key: str, default: str = "") -> float:
        return finite_number(element.get(key, default), f"{self.where}: {key} of {element.tag}")

    def _speed(self) -> tuple[float, float] | None:
        """Return the one speed (m/s) that it is given, and the rate (m/s²) at which it comes to it from rest."""
        speeds = [one for action in self.others for one in action.iter("SpeedAction")]
        targets = [one for action in speeds for one in action.iter("AbsoluteTargetSpeed")]
        dynamics = [one for action in speeds for one in action.iter("SpeedActionDynamics")]
        if not len(speeds) == len(targets) == len(dynamics) == 1:
            return None
        speed, value = self._number(targets[0], "value"), self._number(dynamics[0], "value", "0")
        said = dynamics[0].get("dynamicsShape"), dynamics[0].get("dynamicsDimension")
        if speed <= 0.0 or value < 0.0:
            return None
        if said[0] == "step" or value == 0.0:
            return speed, math.inf
        rates = {"rate": value, "time": speed / value, "distance": 0.5 * speed**2 / value}
        return (speed, rates[said[1]]) if said[0] == "linear" and said[1] in rates else None

    # Shapes: time (s, nan where there is none), x, y

    def _points(self, shape: Element, kind: str = "Vertex") -> FloatArray:
        """Return time, x and y of vertices or control points, n × 3."""
        rows = [
            (self._number(one, "time") if "time" in one.attrib else math.nan, *self._place(one.find("Position")))
            for one in shape.findall(kind)
        ]
        return np.array(rows, np.float64).reshape(-1, 3)

    def _nurbs(self, shape: Element) -> FloatArray:
        """Return places along a rational B-spline; its control points' times are a dimension like x and y."""
        order, points = int(self._number(shape, "order")), self._points(shape, "ControlPoint")
        weights = np.array([self._number(one, "weight", "1") for one in shape.findall("ControlPoint")])
        knots = np.array([self._number(one, "value") for one in shape.findall("Knot")])
        if order < 2 or len(points) < order or len(knots) != len(points) + order:
            counts = f"{len(points)} control points and {len(knots)} knots"
            raise self._refused(f"follows a NURBS of order {order} with {counts}, which do not go together")
        begin, end = knots[order - 1], knots[len(points)]
        if (weights <= 0.0).any() or (np.diff(knots) < 0.0).any() or begin >= end:
            raise self._refused("follows a NURBS with weights or knots that must be above others")
        spline = BSpline(knots, np.column_stack([points, np.ones(len(points))]) * weights[:, None], order - 1)
        at = np.linspace(begin, end, _SAMPLES + 1)
        at[-1] = np.nextafter(at[-1], -math.inf)
        found = spline(at)
        return np.asarray(found[:, :3] / found[:, 3:])

    def _clothoid(self, shape: Element) -> FloatArray:
        """Return places along a clothoid, and its times, which pass as its length does."""
        prime = "curvaturePrime" if "curvaturePrime" in shape.attrib else "curvatureDot"
        bend, change, length = (self._number(shape, key) for key in ("curvature", prime, "length"))
        world = shape.find("Position/WorldPosition")
        if world is None:
            raise self._refused("its clothoid does not begin at a WorldPosition")
        x, y, h = self._number(world, "x"), self._number(world, "y"), self._number(world, "h", "0")
        x, y, _, along = _spiral(x, y, h, bend, change, length).T
        begin, end = (_number_or_none(shape.get(key)) for key in ("startTime", "stopTime"))
        times = np.full(len(along), math.nan)
        if begin is not None and end is not None:
            times = begin + (end - begin) * along / length
        return np.column_stack([times, x, y])

    def _place(self, position: Element | None) -> tuple[float, float]:
        """Return x and y of a position, m.

        Raises:
            UsageError: it is of a kind that is not read, or its road is not.
        """
        found = next(iter(position), Element("none")) if position is not None else Element("none")
        if found.tag == "WorldPosition":
            return self._number(found, "x"), self._number(found, "y")
        here = f"a vertex is at a {found.tag}"
        if found.tag not in ("LanePosition", "RoadPosition"):
            raise self._refused(f"{here}, and read are WorldPosition, LanePosition, RoadPosition")
        if self.road_map is None or not is_there(self.road_map) or not self.road_map.is_file():
            name = "no file" if self.road_map is None else self.road_map.name
            raise self._refused(f"{here}, not at a WorldPosition, and its OpenDRIVE is {name} here")
        road = _roads(self.road_map).get(found.get("roadId", ""))
        if road is None:
            raise self._refused(f"a vertex is on road {found.get('roadId')!r}, which the OpenDRIVE does not have")
        s, t, lane, offset = (self._number(found, key, "0") for key in ("s", "t", "laneId", "offset"))
        try:
            return _on_road(road, s, t if found.tag == "RoadPosition" else _lane_centre(road, s, int(lane)) + offset)
        except UsageError as error:
            raise self._refused(f"a vertex is at {s:g} m of road {found.get('roadId')!r}: {error}") from error


def _shape(follow: Element) -> tuple[str, Element | None]:
    """Return kind and element of the shape that is followed."""
    shape = next(follow.iter("Shape"), None)
    if shape is None or not len(shape):
        return ("trajectory of a catalogue" if follow.find(".//CatalogReference") is not None else "no shape"), None
    return shape[0].tag, shape[0]


def _number_or_none(text: str | None) -> float | None:
    try:
        return finite_number(text or "", "")
    except UsageError:
        return None


# --- OpenDRIVE


@cache
def _roads(path: Path) -> dict[str, Element]:
    return {one.get("id", ""): one for one in read_xml(path).iter("road")}


def _value(element: Element, key: str) -> float:
    return finite_number(element.get(key, ""), f"OpenDRIVE: {key} of {element.tag}")


def _last_before(elements: Sequence[Element], s: float, key: str = "s") -> Element | None:
    before = [one for one in elements if _value(one, key) <= s + 1e-9]
    return max(before, key=lambda one: _value(one, key), default=None)


def _cubic(elements: Sequence[Element], s: float, key: str = "s") -> float:
    """Return the value at s of what is said in pieces of third degree; 0 where nothing is."""
    piece = _last_before(elements, s, key)
    return 0.0 if piece is None else float(np.polyval([_value(piece, one) for one in "dcba"], s - _value(piece, key)))


def _lane_centre(road: Element, s: float, lane: int) -> float:
    """Return the offset of a lane's middle from the reference line, m, to the left."""
    offset, section = _cubic(road.findall("lanes/laneOffset"), s), _last_before(road.findall("lanes/laneSection"), s)
    if not lane:
        return offset
    lanes = [] if section is None else section.findall(f"{'left' if lane > 0 else 'right'}/lane")
    begin = 0.0 if section is None else _value(section, "s")
    widths = {int(_value(one, "id")): _cubic(one.findall("width"), s - begin, "sOffset") for one in lanes}
    if lane not in widths:
        raise UsageError(f"it has no lane {lane}")
    inner = sum(width for number, width in widths.items() if abs(number) < abs(lane))
    return offset + math.copysign(inner + 0.5 * widths[lane], lane)


def _on_road(road: Element, s: float, t: float) -> tuple[float, float]:
    """Return x and y of a place by its path coordinates, m."""
    piece = _last_before(road.findall("planView/geometry"), s)
    shape = None if piece is None or not len(piece) else piece[0]
    if piece is None or shape is None or s > _value(road, "length") + 1e-6:
        raise UsageError("it has no geometry there")
    x, y, heading, length = (_value(piece, key) for key in ("x", "y", "hdg", "length"))
    ds = s - _value(piece, "s")
    if shape.tag == "paramPoly3":
        at = ds if shape.get("pRange") == "arcLength" else ds / length
        curves = [np.poly1d([_value(shape, f"{one}{axis}") for one in "dcba"]) for axis in "UV"]
        (u, v), (du, dv) = (one(at) for one in curves), (one.deriv()(at) for one in curves)
        x, y = x + u * math.cos(heading) - v * math.sin(heading), y + u * math.sin(heading) + v * math.cos(heading)
        heading += math.atan2(dv, du)
    elif shape.tag in _CURVATURES:
        begin, end = (_value(shape, key) if key else 0.0 for key in _CURVATURES[shape.tag])
        x, y, heading = _spiral(x, y, heading, begin, (end - begin) / length, ds)[-1, :3]
    else:
        raise UsageError(f"a {shape.tag}; read are {', '.join(_CURVATURES)}, paramPoly3")
    return float(x - t * math.sin(heading)), float(y + t * math.cos(heading))


_CURVATURES = {"line": ("", ""), "arc": ("curvature", "curvature"), "spiral": ("curvStart", "curvEnd")}
"""Keys of the curvature (1/m) at both ends of a piece of road; empty: 0."""


def _spiral(x: float, y: float, heading: float, bend: float, change: float, length: float) -> FloatArray:
    """Return places on a line whose curvature (1/m) changes evenly: x, y, heading (rad), length so far, n × 4, m."""
    along = np.linspace(0.0, length, _SAMPLES + 1)
    headings = heading + bend * along + 0.5 * change * along**2
    moved = [length * cumulative_simpson(one(headings), dx=1.0 / _SAMPLES, initial=0.0) for one in (np.cos, np.sin)]
    return np.column_stack([x + moved[0], y + moved[1], headings, along])


# --- parameters

_OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.Mod: operator.mod, ast.USub: operator.neg, ast.UAdd: operator.pos, ast.Not: operator.not_,
    ast.Eq: operator.eq, ast.NotEq: operator.ne, ast.Lt: operator.lt, ast.LtE: operator.le,
    ast.Gt: operator.gt, ast.GtE: operator.ge,
    ast.And: lambda *values: all(values), ast.Or: lambda *values: any(values),
}  # fmt: skip
_NAMES: dict[str, Any] = {
    "round": round, "floor": math.floor, "ceil": math.ceil, "sqrt": math.sqrt, "pow": math.pow, "abs": abs, "min": min,
    "max": max, "pi": math.pi, "true": True, "false": False,
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
    if not (text.startswith("${") and text.endswith("}")):
        return declared.get(text[1:], text) if text.startswith("$") else text
    inner = text[2:-1]
    for name in sorted(declared, key=len, reverse=True):  # the longest first
        value = declared[name]
        inner = inner.replace(f"${name}", f"({value})" if _number_or_none(value) is not None else repr(value))
    try:
        found = _computed(ast.parse(inner.strip(), mode="eval").body)
    except (SyntaxError, ValueError, TypeError, ArithmeticError, LookupError, AttributeError, RecursionError):
        return text
    return str(found).lower() if isinstance(found, bool) else found if isinstance(found, str) else repr(found)


def _computed(node: ast.AST) -> Any:
    """Return the value of an expression of numbers, by the operators and functions of the standard."""
    match node:
        case ast.Constant(value=value):
            return value
        case ast.Name(id=name):
            return _NAMES[name]
        case ast.UnaryOp(op=op, operand=one):
            return _OPERATORS[type(op)](_computed(one))
        case ast.BinOp(op=op, left=left, right=right) | ast.Compare(ops=[op], left=left, comparators=[right]):
            return _OPERATORS[type(op)](_computed(left), _computed(right))
        case ast.BoolOp(op=op, values=values):
            return _OPERATORS[type(op)](*map(_computed, values))
        case ast.Call(func=ast.Name(id=name), args=values, keywords=[]):
            return _NAMES[name](*map(_computed, values))
    raise ValueError(ast.dump(node))
