"""The road that the predicted car follows: the straight lane x = 0, driven to the North, or one with curves.

On the straight lane path coordinates are the world's own. On a curved road the car's place is a path coordinate, and
what is near it is seen from the car's own frame.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.road import HEADING_NORTH, road_pose, road_position, straight_from
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import to_car_frame

from skd_adversary.crossing.interfaces import Pair, RoadKernels, kernels_in, template, touch

_GRAZE: Final = 1e-9  # m


@kernel(inline=True)
def _from_aside(ahead: float, left: float, aside: Pair) -> Pair:
    """Return how far ahead and to the left (m) of a car aside of the centre line a point is, from those of the line."""
    offset, turned = aside
    cos, sin = math.cos(turned), math.sin(turned)
    return cos * ahead - sin * (left + offset), sin * ahead + cos * (left + offset)


class _Straight:
    """A straight road to the North."""

    @kernel(inline=True)
    def on_road(parameters: Any, x: float, y: float) -> Pair:
        return x, y

    @kernel(inline=True)
    def velocity_on_road(parameters: Any, x: float, y: float, vx: float, vy: float) -> Pair:
        return vx, vy

    @kernel(inline=True)
    def from_car(parameters: Any, x: float, y: float, car_s: float) -> Pair:
        return y - car_s, -x

    @kernel(inline=True)
    def to_middle(parameters: Any, x: float, y: float, car_s: float, aside: Pair) -> Pair:
        if aside[0] == 0.0 and aside[1] == 0.0:
            return x, y
        ahead, left = _from_aside(y - car_s, -x, aside)
        return -left, car_s + ahead

    @kernel(inline=True)
    def left_behind(parameters: Any, x: float, y: float, car_s: float) -> bool:
        return bool(car_s - parameters.rear > y + parameters.radius)

    @kernel(inline=True)
    def at_distance(parameters: Any, x: float, y: float, distance: float, behind: bool) -> float:
        along = math.sqrt(max(0.0, distance * distance - x * x))
        return y - along if behind else y + along

    @template
    def contact(
        parameters: Any, place: Pair, place_after: Pair, heading: float, car_s: float, car_s_after: float
    ) -> float:
        """Interface `contact`: both in the world's own frame."""
        p = parameters
        x, y = place
        x_after, y_after = place_after
        # Far away, which is most of the time, the swept test need not be made. Who would only graze the car's side is
        # away, too: there the world's rounding decides, of a car that does not drive along x = 0 to the last bit.
        margin = p.radius + p.half_width - _GRAZE
        if (x < -margin and x_after < -margin) or (x > margin and x_after > margin):
            return math.inf
        if y - car_s > p.front + p.radius and y_after - car_s_after > p.front + p.radius:
            return math.inf
        return touch(p, (y - car_s, -x), (y_after - car_s_after, -x_after), heading - HEADING_NORTH)


STRAIGHT = RoadKernels("straight", lambda scenario: {}, **kernels_in(_Straight))


_SAGITTA: Final = 1e-3  # m, between a chord and its arc: a thousandth of what the sensors see
_HALVINGS = 30


def _curved_parameters_of(scenario: Scenario) -> Mapping[str, Any]:
    """Return the centre line, where its straight rest begins, m, and a length of chords (m) for the sharpest curve."""
    line = scenario.road.line
    sharpest = float(abs(line[:, 4]).max())
    return {"line": line.copy(), "straight_from": straight_from(line), "chord": math.sqrt(8.0 * _SAGITTA / sharpest)}


@kernel(inline=True)
def _curved_from_car(parameters: Any, x: float, y: float, car_s: float) -> Pair:
    car_x, car_y, heading = road_pose(parameters.line, car_s)
    return to_car_frame(x, y, car_x, car_y, heading)


class _Curved:
    """A road along a line with curves."""

    @kernel(inline=True)
    def on_road(parameters: Any, x: float, y: float) -> Pair:
        along, left = road_position(parameters.line, x, y)
        return -left, along

    @kernel(inline=True)
    def velocity_on_road(parameters: Any, x: float, y: float, vx: float, vy: float) -> Pair:
        along, _ = road_position(parameters.line, x, y)
        _, _, heading = road_pose(parameters.line, along)
        cos, sin = math.cos(heading), math.sin(heading)
        return sin * vx - cos * vy, cos * vx + sin * vy

    @kernel(inline=True)
    def to_middle(parameters: Any, x: float, y: float, car_s: float, aside: Pair) -> Pair:
        if aside[0] == 0.0 and aside[1] == 0.0:
            return x, y
        car_x, car_y, heading = road_pose(parameters.line, car_s)
        cos, sin = math.cos(heading), math.sin(heading)
        ahead, left = to_car_frame(x, y, car_x, car_y, heading)
        ahead, left = _from_aside(ahead, left, aside)
        return car_x + cos * ahead - sin * left, car_y + sin * ahead + cos * left

    @kernel(inline=True)
    def left_behind(parameters: Any, x: float, y: float, car_s: float) -> bool:
        """Interface `left_behind`: beyond the last curve, and seen from the car."""
        p = parameters
        if car_s < p.straight_from:
            return False
        ahead, _ = _curved_from_car(p, x, y, car_s)
        return bool(ahead < -(p.rear + p.radius))

    @kernel(inline=True)
    def at_distance(parameters: Any, x: float, y: float, distance: float, behind: bool) -> float:
        """Interface `at_distance`: by bisection; an arc is at most π/2 times as long as its chord, to half a turn."""
        near, _ = road_position(parameters.line, x, y)
        far = near - 2.0 * distance if behind else near + 2.0 * distance
        for _ in range(_HALVINGS):
            middle = 0.5 * (near + far)
            ahead, left = _curved_from_car(parameters, x, y, middle)
            if ahead * ahead + left * left < distance * distance:
                near = middle
            else:
                far = middle
        return near

    @template
    def contact(
        parameters: Any, place: Pair, place_after: Pair, heading: float, car_s: float, car_s_after: float
    ) -> float:
        """Interface `contact`: piece by piece, each a chord of the car's path."""
        p = parameters
        x, y = place
        x_after, y_after = place_after
        ahead, left = _curved_from_car(p, x, y, car_s)
        travelled = car_s_after - car_s
        reach = math.hypot(max(p.front, p.rear), p.half_width) + p.radius
        if math.hypot(ahead, left) > reach + travelled + math.hypot(x_after - x, y_after - y):
            return math.inf
        pieces = max(1, math.ceil(travelled / p.chord))
        for piece in range(pieces):
            share = (piece + 1) / pieces
            car_here = car_s + share * travelled
            x_here, y_here = x + share * (x_after - x), y + share * (y_after - y)
            ahead_here, left_here = _curved_from_car(p, x_here, y_here, car_here)
            _, _, car_heading = road_pose(p.line, car_here)
            fraction = touch(p, (ahead, left), (ahead_here, left_here), heading - car_heading)
            if fraction <= 1.0:
                return float((piece + fraction) / pieces)
            ahead, left = ahead_here, left_here
        return math.inf

    from_car = _curved_from_car


CURVED = RoadKernels("curved", _curved_parameters_of, **kernels_in(_Curved))
