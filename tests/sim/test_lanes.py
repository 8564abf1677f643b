"""Lanes of a road: where they are, which way they are driven, and what a scenario's file says by them."""

from __future__ import annotations

import copy
import math
from typing import Any

import numpy as np
import pytest
import shapely
from skd_sim.scenario.road import ONCOMING, Lane, Part, Road
from skd_sim.scenario.scenario import Scenario, load_scenario, scenario_from_dict

BASE = load_scenario("crossing").as_dict()
TURN = load_scenario("right_turn").as_dict()
FOUR = (Lane(-1, direction=ONCOMING), Lane(-2, 3.0, ONCOMING), Lane(1, 2.5), Lane(7, 4.0, x=5.0, y=20.0, heading=0.0))
LANES = [
    {"number": -1, "direction": "oncoming"},
    {"number": 1, "width": 3.0},
    {"number": 9, "x": 0.0, "y": 30.0, "heading": 0.0},
]
BOX = {"kind": "car", "length": 4.0, "width": 1.8}


def scenario_with(base: dict[str, Any] = BASE, **changes: Any) -> Scenario:
    """A scenario with LANES; sections that are given replace those keys of its own."""
    data = copy.deepcopy(base)
    data["road"]["lanes"] = copy.deepcopy(LANES)
    return scenario_from_dict(data | changes, "mine.yaml")


def adversary(**keys: Any) -> dict[str, Any]:
    """The crossing's adversary without its place, and with other keys."""
    own = BASE["adversary"]
    return {key: value for key, value in own.items() if key not in ("start_x", "start_y")} | keys


def test_lanes_of_a_curve_keep_their_distance_from_it() -> None:
    """Against shapely's distance to a finely drawn centre line."""
    road = Road(3.5, parts=(Part(40.0), Part(4.0 * math.pi, 8.0, "right"), Part(40.0)), origin=45.0, lanes=FOUR[:3])
    middle = shapely.LineString([road.place(0, along)[:2] for along in np.linspace(-45.0, 47.5, 5000)])
    for number, away in ((-2, 6.75), (-1, 3.5), (1, 3.0)):
        for along in np.linspace(-40.0, 40.0, 33):
            x, y, heading = road.place(number, along)
            assert middle.distance(shapely.Point(x, y)) == pytest.approx(away, abs=1e-3)
            here, further = (np.array(road.place(number, along + step)[:2]) for step in (-1e-4, 1e-4))
            driven = (further - here) * (1.0 if number > 0 else -1.0)
            assert math.remainder(math.atan2(driven[1], driven[0]) - heading, math.tau) == pytest.approx(0.0, abs=1e-3)


def test_an_adversary_starts_on_a_lane() -> None:
    oncoming = adversary(**BOX, lane=-1, along=25.0)
    del oncoming["radius"]
    found = scenario_with(adversary=oncoming).adversary
    assert (found.start_x, found.start_y, found.start_heading) == (-3.5, 25.0, -math.pi / 2)
    turned = scenario_with(adversary={**oncoming, "aside": 0.5, "start_heading": 0.1}).adversary
    assert (turned.start_x, turned.start_y, turned.start_heading) == (-3.0, 25.0, 0.1)
    across = scenario_with(adversary={**oncoming, "lane": 9, "along": -20.0}).adversary
    assert (across.start_x, across.start_y, across.start_heading) == pytest.approx((-20.0, 30.0, 0.0))


def test_a_scenario_holds_coordinates_alone() -> None:
    """So whoever writes by lanes, and whoever writes by coordinates, have the same scenario."""
    one = scenario_with(adversary=adversary(lane=1, along=2.0, destination_x=-3.0))
    assert scenario_from_dict(one.as_dict()) == one
    same = adversary(start_x=3.25, start_y=2.0, start_heading=math.pi / 2, destination_x=-3.0)
    assert scenario_with(adversary=same) == one
    assert not {"lane", "along"} & set(one.as_dict()["adversary"])


def test_obstacles_and_others_on_lanes() -> None:
    parked = {"lane": -1, "along": 20.0, "length": 4.0, "width": 1.8}
    ways = [[{"time": 0.0, "lane": -1, "along": 60.0}, {"time": 5.0, "lane": -1, "along": 10.0}]]
    ways += [[{"time": 0.0, "lane": 1, "along": 0.0}, {"time": 2.0, "lane": 0, "along": 20.0}]]
    one = scenario_with(obstacles=[parked], others=[{**BOX, "way": way} for way in ways])
    (obstacle,) = one.obstacles
    assert (obstacle.x, obstacle.y, obstacle.heading) == (-3.5, 20.0, -math.pi / 2)
    comes, changes = one.others_after(0.9)
    assert comes == pytest.approx((-3.5, 51.0, 0.0, -10.0, -math.pi / 2), abs=1e-6)
    assert changes == pytest.approx((3.25 - 0.9 * 1.625, 9.0, -1.625, 10.0, math.atan2(10.0, -1.625)), abs=1e-6)


def test_others_follow_a_lane_around_a_curve() -> None:
    way = [{"time": 0.0, "lane": 1, "along": -30.0}, {"time": 6.0, "lane": 1, "along": 30.0}]
    one = scenario_with(TURN, others=[{**BOX, "way": way}])
    for elapsed in np.linspace(0.0, 6.0, 21):
        (state,) = one.others_after(elapsed)
        along, left = one.end.place(state.x, state.y)[::-1]
        assert left == pytest.approx(3.25, abs=0.05)
        assert along == pytest.approx(-30.0 + 10.0 * elapsed, abs=0.2)


def test_a_region_of_a_lane_ends_at_its_edges() -> None:
    leaves = adversary(start_x=-6.0, start_y=2.0)
    del leaves["destination_x"]
    end = scenario_with(adversary=leaves, ending={"arrived": {"lane": 1, "ahead_of": -5.0}}).end
    assert [end.arrived(x, 0.0) for x in (1.7, 1.8, 4.7, 4.8)] == [False, True, True, False]
    assert not end.arrived(3.0, -5.5)
