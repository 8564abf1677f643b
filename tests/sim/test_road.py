"""Roads and lanes."""

import copy
import math
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from skd_sim.scenario.road import (
    HEADING_NORTH,
    ONCOMING,
    Lane,
    Part,
    Road,
    beside_road,
    centre_line,
    is_straight_north,
    right_and_along,
    road_pose,
    road_position,
)
from skd_sim.scenario.scenario import Scenario, load_scenario, scenario_from_dict
from test_scenario import BASE, LANES

BEYOND = 40.0  # m of the straight lines at both ends that are sampled
SPACING = 0.01  # m between samples: the chord of an arc of 3 m radius is 4 µm off

straight = st.tuples(st.integers(1, 30).map(float), st.just(0.0))
curve = st.tuples(st.integers(1, 12).map(float), st.sampled_from([-1.0 / 4, -1.0 / 8, 1.0 / 8, 1.0 / 20, 1e-5]))
some_parts = st.lists(st.one_of(straight, curve), min_size=1, max_size=4).filter(
    lambda parts: any(curvature for _, curvature in parts)
)
fraction = st.integers(0, 1000).map(lambda thousandths: thousandths / 1000)
coordinate = st.integers(-30_000, 30_000).map(lambda millimetres: 1e-3 * millimetres)
RIGHT_TURN = centre_line([(40.0, 0.0), (4.0 * math.pi, -1.0 / 8.0), (20.0, 0.0)], 45.0)


def sampled(line: np.ndarray) -> tuple[np.ndarray, shapely.LineString]:
    """Integrate the line's heading over short steps: independent of the arcs' closed form."""
    first, last = line[0, 0] - BEYOND, line[-1, 0] + line[-1, 5] + BEYOND
    s = np.arange(first, last + SPACING, SPACING)
    middles = 0.5 * (s[1:] + s[:-1])
    curvature = np.zeros_like(middles)
    for begin, _, _, _, k, length in line:
        overlap = np.clip(s[1:], begin, begin + length) - np.clip(s[:-1], begin, begin + length)
        curvature += k * overlap / SPACING
    turn = np.concatenate([[0.0], np.cumsum(SPACING * curvature)])
    # Headings and positions relative to the crossing point, s = 0.
    heading = turn - np.interp(0.0, s, turn) + HEADING_NORTH
    between = 0.5 * (heading[1:] + heading[:-1])
    points = np.zeros((len(s), 2))
    points[1:, 0], points[1:, 1] = np.cumsum(SPACING * np.cos(between)), np.cumsum(SPACING * np.sin(between))
    points -= [np.interp(0.0, s, points[:, 0]), np.interp(0.0, s, points[:, 1])]
    return s, shapely.LineString(points)


@settings(max_examples=40)
@given(parts=some_parts, origin=fraction, at=fraction, x=coordinate, y=coordinate)
def test_both_ways_against_a_sampled_line(parts, origin, at, x, y):
    line = centre_line(parts, origin * sum(length for length, _ in parts))
    s, path = sampled(line)
    wanted = s[0] + at * (s[-1] - s[0])
    along = path.interpolate(wanted - s[0])
    assert road_pose(line, wanted)[:2] == pytest.approx((along.x, along.y), abs=2e-3)
    # The nearest point: no sample is nearer, and it lies where it says.
    found, left = road_position(line, x, y)
    distance = path.distance(shapely.Point(x, y))
    if s[0] < found < s[-1]:
        assert abs(left) == pytest.approx(distance, abs=2e-3)
    else:
        assert abs(left) <= distance + 2e-3
    foot_x, foot_y, heading = road_pose(line, found)
    assert foot_x - left * math.sin(heading) == pytest.approx(x, abs=1e-6)
    assert foot_y + left * math.cos(heading) == pytest.approx(y, abs=1e-6)
    # Where only one point is near, it is the one that shapely finds.
    projected = s[0] + path.project(shapely.Point(x, y))
    if abs(left) < 1.5:
        assume(distance == pytest.approx(abs(left), abs=2e-3))
        others = shapely.distance(shapely.Point(x, y), shapely.points(shapely.get_coordinates(path)))
        rivals = s[others < distance + 0.05]
        if np.ptp(rivals) < 2.0:
            assert found == pytest.approx(projected, abs=0.05)


@given(parts=some_parts, origin=fraction)
def test_the_crossing_point_is_the_origin_and_the_lane_leads_north_there(parts, origin):
    line = centre_line(parts, origin * sum(length for length, _ in parts))
    assert road_pose(line, 0.0) == pytest.approx((0.0, 0.0, HEADING_NORTH), abs=1e-9)


@given(right=st.integers(-3900, 3900).map(lambda mm: 1e-3 * mm), s=coordinate)
def test_offsets_to_the_right_both_ways(right: float, s: float) -> None:
    """By a frame made here: the right is a quarter turn clockwise from where the road leads."""
    x, y, heading = road_pose(RIGHT_TURN, s)
    turned = heading - math.pi / 2
    expected = [(x + right * math.cos(turned), y + right * math.sin(turned))]
    positions = beside_road(RIGHT_TURN, np.array([[right, s]]))
    np.testing.assert_allclose(positions, expected, atol=1e-9)
    np.testing.assert_allclose(right_and_along(RIGHT_TURN, positions), [(right, s)], atol=1e-6)
    straight = Road(3.5).line
    assert beside_road(straight, np.array([[right, s]])).tolist() == [[right, s]]
    assert right_and_along(straight, np.array([[right, s]])).tolist() == [[right, s]]


@given(x=st.floats(-1e3, 1e3), y=st.floats(-1e3, 1e3))
def test_the_straight_lane_to_the_north_is_exact(x: float, y: float) -> None:
    for road in (Road(3.5), Road(3.5, parts=(Part(40.0), Part(10.0)), origin=12.0)):
        assert road.straight
        assert is_straight_north(road.line)
        assert road_pose(road.line, y) == (0.0, y, math.pi / 2)
        assert road_position(road.line, x, y) == (y, -x)
    assert not Road(3.5, parts=(Part(5.0, 8.0, "left"),)).straight


TURN = load_scenario("right_turn").as_dict()
FOUR = (Lane(-1, direction=ONCOMING), Lane(-2, 3.0, ONCOMING), Lane(1, 2.5), Lane(7, 4.0, x=5.0, y=20.0, heading=0.0))
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
