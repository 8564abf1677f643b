"""The road: the car's lane, lanes beside it and elsewhere, and path coordinates along a lane, both ways.

The centre line of the car's lane is made of straight and circular parts.

The path coordinate s (m) is 0 at the world's origin, which is the crossing point, and negative before it; there the
lane leads North. Beyond its two ends the line goes on straight. A line is an array, one row per part: s where it
begins, x, y and heading there, curvature, length (m; rad counter-clockwise from East; 1/m, positive to the left).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np

from skd_sim.errors import UsageError
from skd_sim.inputs.model import Frozen, OneOf, limits
from skd_sim.kernels.compilation import kernel
from skd_sim.world.contact import to_car_frame
from skd_sim.world.state import FloatArray, Pair, Triple

HEADING_NORTH = math.pi / 2  # where the lane leads at the crossing point (ENU)
_JOINT = 1e-9  # m that a point may lie beyond a part, by rounding, and still belong to it
_EDGE_SPACING = 0.25  # m: of a curve of 8 m radius 1 mm off
_ARROW_SPACING, _ARROW = 8.0, np.array([(0.0, 0.7), (0.3, -0.7), (-0.3, -0.7)])  # m: to the right, ahead
SAME, ONCOMING = "same", "oncoming"
STRAIGHT_NORTH = (0.0, 0.0, 0.0, HEADING_NORTH, 0.0, 0.0)  # without an end: it goes on straight both ways


@dataclass(frozen=True)
class Part(Frozen):
    """A stretch of road: straight, or with `radius` (of the centre line) and `turn` along a circle."""

    length: Annotated[float, limits(0.1, 10000.0, "m")]
    radius: Annotated[float, limits(1.0, 100000.0, "m")] | None = None
    turn: Annotated[str, OneOf(("left", "right"))] | None = None

    def __post_init__(self) -> None:
        """Refuse half of a curve, and one of more than half a circle."""
        if (self.radius is None) != (self.turn is None):
            given, missing = ("radius", "turn") if self.turn is None else ("turn", "radius")
            raise UsageError(f"has a {given} and no {missing}; a curve needs both, a straight part neither")
        if self.radius is not None and self.length > math.pi * self.radius:
            raise UsageError(
                f"turns by more than half a circle; its length may be at most {math.pi * self.radius:.4g} m"
            )

    @property
    def curvature(self) -> float:
        """Curvature of the centre line, 1/m, positive to the left."""
        if self.radius is None:
            return 0.0
        return 1.0 / self.radius if self.turn == "left" else -1.0 / self.radius


@dataclass(frozen=True)
class Lane(Frozen):
    """A lane that the car under test is not on. The car's own has number 0, those beside it 1, 2, … and −1, −2, ….

    Numbers increase to the right. Traffic on a lane beside the car's goes the car's way (`direction: same`) or comes
    towards it (`oncoming`). One with a `heading` is elsewhere: it leads straight through (x, y), driven that way, as
    that of a road which crosses; its number is any that is free. Without a `width` it is as wide as the car's own.
    """

    number: Annotated[int, limits(-99, 99, "lanes to the right of the car's own")]
    width: Annotated[float, limits(1.0, 20.0, "m")] | None = None
    direction: Annotated[str, OneOf((SAME, ONCOMING))] = SAME
    x: Annotated[float, limits(-500.0, 500.0, "m, where its coordinate is 0")] | None = None
    y: Annotated[float, limits(-500.0, 500.0, "m, where its coordinate is 0")] | None = None
    heading: Annotated[float, limits(-math.pi, math.pi, "rad, counter-clockwise from East")] | None = None

    def __post_init__(self) -> None:
        """Refuse half of a place, and a direction beside a heading."""
        given = [name for name in ("x", "y", "heading") if getattr(self, name) is not None]
        if given and len(given) < 3:
            raise UsageError(f"has {' and '.join(given)}; a lane elsewhere needs x, y and heading")
        if not self.beside and self.direction == ONCOMING:
            raise UsageError("has a heading, which says which way it is driven; leave direction out")

    @property
    def beside(self) -> bool:
        """Whether it goes along with the car's own lane, beside it or as that lane itself."""
        return self.heading is None


@dataclass(frozen=True)
class Road(Frozen):
    """The car's lane, straight along +y through (0, 0) or of `parts` in the order in which the car drives them; others.

    `origin` is how far along the parts the crossing point lies, their middle by default; there the lane leads North.
    `friction` is relative to a dry road (1); wet asphalt about 0.65 (docs/decisions.md, 4). Basic cars have no tyres:
    with them only 1 is accepted. `lanes` are those that the car is not on.
    """

    lane_width: Annotated[float, limits(1.0, 20.0, "m")]
    friction: Annotated[float, limits(0.05, 1.5, "relative to a dry road")] = 1.0
    parts: tuple[Part, ...] = ()
    origin: Annotated[float, limits(0.0, 100000.0, "m from the beginning of the parts")] | None = None
    lanes: tuple[Lane, ...] = ()

    def __post_init__(self) -> None:
        """Refuse parts that cannot be driven, and lanes that are nowhere."""
        self._check_lanes()
        inner = {turn: 0.5 * self.lane_width + self._beside(side) for turn, side in (("left", -1), ("right", 1))}
        for index, part in enumerate(self.parts):
            if part.radius is not None and part.turn is not None and part.radius <= inner[part.turn]:
                lanes = " and the widths of lanes on that side" if inner[part.turn] > 0.5 * self.lane_width else ""
                raise UsageError(
                    f"parts[{index}].radius must exceed half of lane_width{lanes} ({inner[part.turn]:g} m), "
                    f"got {part.radius:g}"
                )
        if self.origin is not None and not self.parts:
            raise UsageError("origin says where along parts the crossing point is; there are no parts")
        if self.origin is not None and self.origin > self.length:
            raise UsageError(f"origin must be at most the length of all parts ({self.length:g} m), got {self.origin:g}")

    def _check_lanes(self) -> None:
        numbers = [lane.number for lane in self.lanes]
        beside = {0, *(lane.number for lane in self.lanes if lane.beside)}
        for index, lane in enumerate(self.lanes):
            if lane.number == 0 or lane.number in numbers[:index]:
                whose = "the car's own lane" if lane.number == 0 else "another lane"
                raise UsageError(f"lanes[{index}].number {lane.number} is that of {whose}; give each lane its own")
            inner = lane.number - int(math.copysign(1, lane.number))
            if lane.beside and inner not in beside:
                raise UsageError(
                    f"lanes[{index}].number {lane.number} leaves out lane {inner}, between it and the car's own, which "
                    "is 0; number lanes one by one, or give x, y and heading of one that is elsewhere"
                )

    def _beside(self, side: int) -> float:
        """Return the width of all lanes beside the car's to the left (−1) or to the right (1), m."""
        return sum(lane.width or self.lane_width for lane in self.lanes if lane.beside and side * lane.number > 0)

    @cached_property
    def edges(self) -> Pair:
        """How far the road reaches to the left and to the right of the middle of the car's lane, m."""
        return 0.5 * self.lane_width + self._beside(-1), 0.5 * self.lane_width + self._beside(1)

    @property
    def length(self) -> float:
        """Length of all parts together, m."""
        return sum(part.length for part in self.parts)

    @cached_property
    def line(self) -> FloatArray:
        """Centre line of the car's lane, as an array; see the module."""
        origin = 0.5 * self.length if self.origin is None else self.origin
        return centre_line([(part.length, part.curvature) for part in self.parts], origin)

    @cached_property
    def straight(self) -> bool:
        """Whether the lane is the whole line x = 0, driven to the North."""
        return bool(is_straight_north(self.line))

    @cached_property
    def every_lane(self) -> dict[int, Lane]:
        """The car's own lane and all others, by their numbers."""
        return {0: Lane(0)} | {lane.number: lane for lane in self.lanes}

    def width(self, number: int = 0) -> float:
        """Return the width of a lane, m."""
        return self.every_lane[number].width or self.lane_width

    def offset(self, number: int = 0) -> float:
        """Return how far to the right of the road's centre line the middle of a lane beside it is, m; elsewhere 0."""
        if number == 0 or not self.every_lane[number].beside:
            return 0.0
        side = int(math.copysign(1, number))
        between = sum(self.width(one) for one in range(side, number, side))
        return side * (0.5 * self.lane_width + between + 0.5 * self.width(number))

    def place(self, number: int, along: float, aside: float = 0.0) -> Triple:
        """Return a place on a lane: x, y (m), and the heading in which it is driven there (rad).

        Args:
            number: number of the lane.
            along: path coordinate of the road, m; of a lane elsewhere, distance from its own point the way it leads.
            aside: distance to the right of the lane's middle, as the road leads, m; of a lane elsewhere, as it leads.
        """
        line = self.line_of(number)
        x, y = beside_road(line, np.array([[self.offset(number) + aside, along]]))[0].tolist()
        turned = math.pi if self.every_lane[number].direction == ONCOMING else 0.0
        return x, y, math.remainder(road_pose(line, along)[2] + turned, math.tau)

    def line_of(self, number: int) -> FloatArray:
        """Return the line along which a lane's coordinate is counted; lanes beside the car's share the car's."""
        lane = self.every_lane[number]
        return self.line if lane.beside else np.array([(0.0, lane.x, lane.y, lane.heading, 0.0, 0.0)])

    def edge(self, side: float, low: float, high: float, number: int = 0) -> FloatArray:
        """Return a lane's edge between two path coordinates (m) as points, n × 2, m; as finely as its curves need.

        Args:
            side: −1 for the left edge, 1 for the right one.
            low: path coordinate at which the edge begins, m.
            high: path coordinate at which the edge ends, m.
            number: number of the lane, by default the car's.
        """
        straight = self.straight or not self.every_lane[number].beside
        count = 2 if straight else 2 + math.ceil((high - low) / _EDGE_SPACING)
        right = np.full(count, self.offset(number) + 0.5 * side * self.width(number))
        return np.asarray(beside_road(self.line_of(number), np.column_stack([right, np.linspace(low, high, count)])))

    def surfaces(self, low: float, high: float) -> list[tuple[FloatArray, FloatArray]]:
        """Return the left and the right edge of every lane between two path coordinates (m); the car's lane is last."""
        numbers = sorted(self.every_lane, key=lambda number: number == 0)
        return [(self.edge(-1.0, low, high, one), self.edge(1.0, low, high, one)) for one in numbers]

    def arrows(self, low: float, high: float) -> list[FloatArray]:
        """Return triangles (3 × 2, m) that point the way each lane is driven; none where the car's is the only one."""
        found = []
        for number in self.every_lane if self.lanes else ():
            for along in np.arange(math.ceil(low / _ARROW_SPACING) * _ARROW_SPACING, high, _ARROW_SPACING).tolist():
                x, y, heading = self.place(number, along)
                ahead, right = (math.cos(heading), math.sin(heading)), (math.sin(heading), -math.cos(heading))
                found.append(np.array([x, y]) + _ARROW @ np.array([right, ahead]))
        return found


def centre_line(parts: list[Pair], origin: float) -> FloatArray:
    """Return the line of parts whose crossing point lies `origin` (m, ≥ 0) behind their beginning.

    Args:
        parts: (length in m, curvature in 1/m) of each part, in driving order; without curves: the straight lane.
        origin: distance from the beginning of the parts to the crossing point, m; at most the length of all parts.
    """
    if all(curvature == 0.0 for _, curvature in parts):
        return np.array([STRAIGHT_NORTH])
    begins = np.concatenate([[0.0], np.cumsum([length for length, _ in parts])[:-1]]) - origin
    middle = int(np.searchsorted(begins, 0.0, side="right")) - 1  # the part with the crossing point
    line = np.array([(s, 0.0, 0.0, 0.0, k, length) for s, (length, k) in zip(begins, parts, strict=True)])
    line[middle, 1:4] = advanced(0.0, 0.0, HEADING_NORTH, line[middle, 4], line[middle, 0])
    for part in range(middle + 1, len(line)):
        _, x, y, heading, curvature, length = line[part - 1]
        line[part, 1:4] = advanced(x, y, heading, curvature, length)
    for part in range(middle - 1, -1, -1):
        _, x, y, heading, _, _ = line[part + 1]
        line[part, 1:4] = advanced(x, y, heading, line[part, 4], -line[part, 5])
    return line


@kernel
def advanced(x: float, y: float, heading: float, curvature: float, distance: float) -> Triple:
    """Return the pose (m, m, rad) after `distance` (m, negative: before) along a line or a circle.

    The chord of an arc of length d and curvature k is 2 sin(kd/2)/k long and lies at half of the turn.
    """
    half_turn = 0.5 * curvature * distance
    chord = distance if half_turn == 0.0 else distance * (math.sin(half_turn) / half_turn)
    direction = heading + half_turn
    return x + chord * math.cos(direction), y + chord * math.sin(direction), heading + 2.0 * half_turn


@kernel
def is_straight_north(line: FloatArray) -> bool:
    """Return whether the line is the whole line x = 0, driven to the North, with s = y."""
    if line.shape[0] != 1:
        return False
    turned = line[0, 4] != 0.0 or line[0, 3] != HEADING_NORTH
    return not (turned or line[0, 1] != 0.0 or line[0, 2] != line[0, 0])


def straight_from(line: FloatArray) -> float:
    """Return the path coordinate (m) from which on the line goes straight; minus infinity if it has no curve."""
    curved = line[line[:, 4] != 0.0]
    return float(curved[-1, 0] + curved[-1, 5]) if len(curved) else -math.inf


@kernel
def _part_at(line: FloatArray, s: float) -> int:
    part = 0
    while part + 1 < line.shape[0] and line[part + 1, 0] <= s:
        part += 1
    return part


@kernel
def road_curvature(line: FloatArray, s: float) -> float:
    """Return the curvature (1/m, positive to the left) at path coordinate s (m); at a joint, of the part behind it."""
    part = _part_at(line, s)
    along = s - line[part, 0]
    return line[part, 4] if 0.0 <= along <= line[part, 5] else 0.0


@kernel
def road_pose(line: FloatArray, s: float) -> Triple:
    """Return x, y (m) and heading (rad, not wrapped) of the centre line at path coordinate s (m)."""
    if is_straight_north(line):
        return 0.0, s, HEADING_NORTH
    part = _part_at(line, s)
    x, y, heading, curvature, length = line[part, 1], line[part, 2], line[part, 3], line[part, 4], line[part, 5]
    along = s - line[part, 0]
    if along < 0.0:
        return advanced(x, y, heading, 0.0, along)
    if along > length:
        x, y, heading = advanced(x, y, heading, curvature, length)
        return advanced(x, y, heading, 0.0, along - length)
    return advanced(x, y, heading, curvature, along)


@kernel
def _arc_foot(x0: float, y0: float, heading: float, curvature: float, length: float, x: float, y: float) -> Pair:
    """Return how far along a circle (m) its point nearest to (x, y) is, and the offset to the left (m).

    Counted from half a circle before the middle of the arc on: a point of an arc of at most half a circle, or one that
    faces it, gets its own place, any other a place before or beyond the arc.
    """
    radius, side = 1.0 / abs(curvature), math.copysign(1.0, curvature)
    ahead, left = to_car_frame(x, y, x0, y0, heading)
    # From the centre, in a frame in which the arc begins at angle 0 and turns counter-clockwise.
    out, on = radius - side * left, ahead
    middle = 0.5 * abs(curvature) * length
    turned = math.atan2(on, out) - middle  # from the middle of the arc
    if turned <= -math.pi:
        turned += 2.0 * math.pi
    return (turned + middle) * radius, side * (radius - math.sqrt(out * out + on * on))


@kernel
def road_position(line: FloatArray, x: float, y: float) -> Pair:
    """Return the path coordinate (m) of the centre line's point nearest to (x, y) (m), and the offset to its left (m).

    Where two points are equally near, the earlier one counts.
    """
    if is_straight_north(line):
        return y, -x
    best, offset = math.inf, math.inf
    last = line.shape[0] - 1
    # The line has no kinks and no ends: the way to its nearest point stands upright on one of the parts, or on one of
    # the straight lines before the first (part −1) and beyond the last.
    for part in range(-1, last + 2):
        row = min(max(part, 0), last)
        begin, x0, y0, heading = line[row, 0], line[row, 1], line[row, 2], line[row, 3]
        curvature, low, high = line[row, 4], 0.0, line[row, 5]
        if part < 0:
            curvature, low, high = 0.0, -math.inf, 0.0
        elif part > last:
            x0, y0, heading = advanced(x0, y0, heading, curvature, high)
            begin, curvature, high = begin + high, 0.0, math.inf
        if curvature == 0.0:
            along, left = to_car_frame(x, y, x0, y0, heading)
        else:
            along, left = _arc_foot(x0, y0, heading, curvature, high, x, y)
        if low - _JOINT <= along <= high + _JOINT and abs(left) < abs(offset):
            best, offset = begin + min(max(along, low), high), left
    return best, offset


@kernel
def beyond(line: FloatArray, edges: Pair, footprint: Triple, path: FloatArray) -> int:
    """Return the first row of a path in which a corner of the car is beyond an edge; −1: in none.

    Args:
        line: centre line.
        edges: how far to the left and to the right of it the edges are, m.
        footprint: front, rear and half width of the car, m.
        path: x, y (m) and heading (rad) of the car in its first three columns.
    """
    front, rear, half_width = footprint
    for row in range(path.shape[0]):
        cos, sin = math.cos(path[row, 2]), math.sin(path[row, 2])
        for ahead in (front, -rear):
            for left in (half_width, -half_width):
                x, y = path[row, 0] + cos * ahead - sin * left, path[row, 1] + sin * ahead + cos * left
                _, aside = road_position(line, x, y)
                if aside > edges[0] or -aside > edges[1]:
                    return row
    return -1


@kernel
def right_and_along(line: FloatArray, positions: FloatArray) -> FloatArray:
    """Return positions (n × 2, m) as offsets to the right of the centre line and path coordinates, n × 2, m.

    That is a frame in which every road is straight and leads North: on the straight lane it is the world's own.
    """
    found = np.empty((positions.shape[0], 2))
    for index in range(positions.shape[0]):
        s, left = road_position(line, positions[index, 0], positions[index, 1])
        found[index, 0], found[index, 1] = -left, s
    return found


@kernel
def beside_road(line: FloatArray, offsets: FloatArray) -> FloatArray:
    """Return the positions (n × 2, m) with these offsets to the right and path coordinates (n × 2, m)."""
    positions = np.empty((offsets.shape[0], 2))
    for index in range(offsets.shape[0]):
        x, y, heading = road_pose(line, offsets[index, 1])
        if is_straight_north(line):
            positions[index, 0], positions[index, 1] = offsets[index, 0], y
        else:
            positions[index, 0] = x + offsets[index, 0] * math.sin(heading)
            positions[index, 1] = y - offsets[index, 0] * math.cos(heading)
    return positions
