from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from skd_sim.scenario.road import (
    HEADING_NORTH,
    Part,
    Road,
    beside_road,
    centre_line,
    is_straight_north,
    right_and_along,
    road_pose,
    road_position,
)

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
