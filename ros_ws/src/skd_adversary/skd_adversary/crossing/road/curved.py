"""A road with curves: the car's place is a path coordinate, and what is near it is seen from the car's own frame."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.road import road_pose, road_position, straight_from
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import to_car_frame

from skd_adversary.crossing.interfaces import touch
from skd_adversary.crossing.parts import RoadKernels, template

_SAGITTA: Final = 1e-3  # m, between a chord and its arc: a thousandth of what the sensors see
_HALVINGS = 30


def parameters_of(scenario: Scenario) -> Mapping[str, Any]:
    """Return the centre line, where its straight rest begins, m, and a length of chords (m) for the sharpest curve."""
    line = scenario.road.line
    sharpest = float(abs(line[:, 4]).max())
    return {"line": line.copy(), "straight_from": straight_from(line), "chord": math.sqrt(8.0 * _SAGITTA / sharpest)}


@kernel(inline=True)
def on_road(parameters: Any, x: float, y: float) -> tuple[float, float]:
    """Interface `on_road`."""
    along, left = road_position(parameters.line, x, y)
    return -left, along


@kernel(inline=True)
def velocity_on_road(parameters: Any, x: float, y: float, vx: float, vy: float) -> tuple[float, float]:
    """Interface `velocity_on_road`."""
    along, _ = road_position(parameters.line, x, y)
    _, _, heading = road_pose(parameters.line, along)
    cos, sin = math.cos(heading), math.sin(heading)
    return sin * vx - cos * vy, cos * vx + sin * vy


@kernel(inline=True)
def from_car(parameters: Any, x: float, y: float, car_s: float) -> tuple[float, float]:
    """Interface `from_car`."""
    car_x, car_y, heading = road_pose(parameters.line, car_s)
    return to_car_frame(x, y, car_x, car_y, heading)


@kernel(inline=True)
def left_behind(parameters: Any, x: float, y: float, car_s: float) -> bool:
    """Interface `left_behind`: beyond the last curve, and seen from the car."""
    p = parameters
    if car_s < p.straight_from:
        return False
    ahead, _ = from_car(p, x, y, car_s)
    return bool(ahead < -(p.rear + p.radius))


@kernel(inline=True)
def at_distance(parameters: Any, x: float, y: float, distance: float, behind: bool) -> float:
    """Interface `at_distance`: by bisection; an arc is at most π/2 times as long as its chord, up to half a turn."""
    near, _ = road_position(parameters.line, x, y)
    far = near - 2.0 * distance if behind else near + 2.0 * distance
    for _ in range(_HALVINGS):
        middle = 0.5 * (near + far)
        ahead, left = from_car(parameters, x, y, middle)
        if ahead * ahead + left * left < distance * distance:
            near = middle
        else:
            far = middle
    return near


@template("touch")
def contact(
    parameters: Any,
    x: float,
    y: float,
    x_after: float,
    y_after: float,
    heading: float,
    car_s: float,
    car_s_after: float,
) -> float:
    """Interface `contact`: piece by piece, each a chord of the car's way."""
    p = parameters
    ahead, left = from_car(p, x, y, car_s)
    travelled = car_s_after - car_s
    reach = math.hypot(max(p.front, p.rear), p.half_width) + p.radius
    if math.hypot(ahead, left) > reach + travelled + math.hypot(x_after - x, y_after - y):
        return math.inf
    pieces = max(1, math.ceil(travelled / p.chord))
    for piece in range(pieces):
        share = (piece + 1) / pieces
        place = car_s + share * travelled
        x_here, y_here = x + share * (x_after - x), y + share * (y_after - y)
        ahead_here, left_here = from_car(p, x_here, y_here, place)
        _, _, car_heading = road_pose(p.line, place)
        fraction = touch(p, ahead, left, ahead_here, left_here, heading - car_heading)
        if fraction <= 1.0:
            return float((piece + fraction) / pieces)
        ahead, left = ahead_here, left_here
    return math.inf


ROAD = RoadKernels("curved", parameters_of, on_road, velocity_on_road, from_car, left_behind, at_distance, contact)
