"""The straight lane x = 0, driven to the North: path coordinates are the world's own."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.road import HEADING_NORTH
from skd_sim.scenario.scenario import Scenario

from skd_adversary.crossing.interfaces import touch
from skd_adversary.crossing.parts import RoadKernels, template

_GRAZE: Final = 1e-9  # m


def parameters_of(scenario: Scenario) -> Mapping[str, Any]:
    """Return nothing: there is nothing to know."""
    return {}


@kernel(inline=True)
def on_road(parameters: Any, x: float, y: float) -> tuple[float, float]:
    """Interface `on_road`."""
    return x, y


@kernel(inline=True)
def velocity_on_road(parameters: Any, x: float, y: float, vx: float, vy: float) -> tuple[float, float]:
    """Interface `velocity_on_road`."""
    return vx, vy


@kernel(inline=True)
def from_car(parameters: Any, x: float, y: float, car_s: float) -> tuple[float, float]:
    """Interface `from_car`."""
    return y - car_s, -x


@kernel(inline=True)
def left_behind(parameters: Any, x: float, y: float, car_s: float) -> bool:
    """Interface `left_behind`."""
    return bool(car_s - parameters.rear > y + parameters.radius)


@kernel(inline=True)
def at_distance(parameters: Any, x: float, y: float, distance: float, behind: bool) -> float:
    """Interface `at_distance`."""
    along = math.sqrt(max(0.0, distance * distance - x * x))
    return y - along if behind else y + along


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
    """Interface `contact`: both in the world's own frame."""
    p = parameters
    # Far away, which is most of the time, the swept test need not be made. Who would only graze the car's side is away,
    # too: there the world's rounding decides, of a car that does not drive along x = 0 to the last bit.
    margin = p.radius + p.half_width - _GRAZE
    if (x < -margin and x_after < -margin) or (x > margin and x_after > margin):
        return math.inf
    if y - car_s > p.front + p.radius and y_after - car_s_after > p.front + p.radius:
        return math.inf
    return touch(p, y - car_s, -x, y_after - car_s_after, -x_after, heading - HEADING_NORTH)


ROAD = RoadKernels("straight", parameters_of, on_road, velocity_on_road, from_car, left_behind, at_distance, contact)
