"""Who is left behind by a car that turns, and who is not."""

from __future__ import annotations

import math
from collections import namedtuple

import numpy as np
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from skd_adversary.crossing.roads import CURVED
from skd_sim.scenario.road import road_pose
from skd_sim.scenario.scenario import Scenario, load_scenario

SCENARIOS = {name: load_scenario(name) for name in ("cbtafs", "cptans", "right_turn")}
Parameters = namedtuple("Parameters", ("line", "straight_from", "chord", "rear", "radius"))


def left_behind(scenario: Scenario, x: float, y: float, car_s: float) -> bool:
    """Return what the model says of a place and a car, m."""
    own = Parameters(**CURVED.parameters(scenario), rear=scenario.car.rear, radius=scenario.adversary.reach)
    return bool(CURVED.left_behind(own, x, y, car_s))


def box(scenario: Scenario, car_s: float) -> shapely.Polygon:
    """Return the footprint of a car at a path coordinate, m."""
    x, y, heading = road_pose(scenario.road.line, car_s)
    car, cos, sin = scenario.car, math.cos(heading), math.sin(heading)
    corners = [(car.front, 1.0), (car.front, -1.0), (-car.rear, -1.0), (-car.rear, 1.0)]
    return shapely.Polygon(
        [
            (x + cos * ahead - side * sin * car.half_width, y + sin * ahead + side * cos * car.half_width)
            for ahead, side in corners
        ]
    )


@settings(max_examples=50)
@given(
    name=st.sampled_from(tuple(SCENARIOS)),
    car_s=st.floats(-20.0, 20.0),
    x=st.floats(-25.0, 25.0),
    y=st.floats(-25.0, 25.0),
    direction=st.floats(-math.pi, math.pi),
)
def test_who_is_left_behind_is_not_met_again(name: str, car_s: float, x: float, y: float, direction: float) -> None:
    """No road user as fast as the car, or slower, meets it again on any straight line."""
    scenario = SCENARIOS[name]
    assume(left_behind(scenario, x, y, car_s))
    reach = scenario.adversary.reach
    for way in np.linspace(0.0, 20.0, 21):
        here = shapely.Point(x + way * math.cos(direction), y + way * math.sin(direction))
        assert box(scenario, car_s + way).distance(here) >= reach - 1e-9
