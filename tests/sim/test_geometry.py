import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import affinity
from skd_sim.world.contact import NO_CONTACT, first_contact, first_contact_of_boxes, rectangle_distance, to_car_frame

FRONT, REAR, HALF_WIDTH = 2.25, 1.75, 0.9
# In micrometres: shapely's distance to a segment of 1e-180 m is infinite.
coordinate = st.integers(-8 * 10**6, 8 * 10**6).map(lambda micrometres: 1e-6 * micrometres)
length = st.floats(0.05, 5.0)


@given(
    ahead=coordinate,
    left=coordinate,
    front=length,
    rear=length,
    half_width=length,
    x=coordinate,
    y=coordinate,
    heading=st.floats(-7.0, 7.0),
)
def test_distance_to_the_footprint_in_the_world(ahead, left, front, rear, half_width, x, y, heading):
    """The car's polygon and the point, both placed in the world by an independent rotation."""
    turn = np.array([[math.cos(heading), -math.sin(heading)], [math.sin(heading), math.cos(heading)]])
    corners = [(front, half_width), (-rear, half_width), (-rear, -half_width), (front, -half_width)]
    polygon = shapely.Polygon(np.array(corners) @ turn.T + (x, y))
    px, py = turn @ (ahead, left) + (x, y)
    a, b = to_car_frame(px, py, x, y, heading)
    assert (a, b) == pytest.approx((ahead, left), abs=1e-9)
    expected = polygon.distance(shapely.Point(px, py))
    assert rectangle_distance(a, b, front, rear, half_width) == pytest.approx(expected, abs=1e-9)


@settings(max_examples=200)  # the first call compiles
@given(start=st.tuples(coordinate, coordinate), end=st.tuples(coordinate, coordinate), radius=length)
def test_first_contact_against_dense_samples(start, end, radius):
    """Distance is 1-Lipschitz in the position: samples bound the first contact from both sides."""
    fraction = float(first_contact(start, end, (FRONT, REAR, HALF_WIDTH), radius))
    s = np.linspace(0.0, 1.0, 4001)
    points = np.outer(1.0 - s, start) + np.outer(s, end)
    polygon = shapely.box(-REAR, -HALF_WIDTH, FRONT, HALF_WIDTH)
    distances = shapely.distance(polygon, shapely.points(points))
    spacing = math.dist(start, end) / 4000.0
    touching = np.flatnonzero(distances <= radius - 1e-9)
    if fraction == NO_CONTACT:
        assert len(touching) == 0
        return
    assert 0.0 <= fraction <= 1.0
    at = shapely.Point(*((1.0 - fraction) * np.array(start) + fraction * np.array(end)))
    # At the contact the disc touches, and it did not before.
    assert polygon.distance(at) <= radius + 1e-7
    if fraction > 0.0:
        assert polygon.distance(at) == pytest.approx(radius, abs=1e-6)
        assert (distances[s < fraction - 1e-9] >= radius - 1e-7).all()
    if len(touching):
        assert fraction <= s[touching[0]] + 1e-9
    else:
        # It touches between two samples only: a graze.
        assert distances.min() <= radius + spacing


@settings(max_examples=200)  # the first call compiles
@given(
    start=st.tuples(coordinate, coordinate),
    end=st.tuples(coordinate, coordinate),
    turned=st.floats(-7.0, 7.0),
    half_length=length,
    half_width=length,
)
def test_first_contact_of_boxes_against_polygons(start, end, turned, half_length, half_width):
    """The swept box is a convex hull; where it stands at the contact it touches, and nowhere before."""
    car = shapely.box(-REAR, -HALF_WIDTH, FRONT, HALF_WIDTH)
    other = affinity.rotate(
        shapely.box(-half_length, -half_width, half_length, half_width), turned, origin=(0, 0), use_radians=True
    )

    def at(s: float) -> shapely.Polygon:
        return affinity.translate(other, *((1.0 - s) * np.array(start) + s * np.array(end)))

    footprint = (FRONT, REAR, HALF_WIDTH)
    fraction = float(first_contact_of_boxes(start, end, turned, footprint, (half_length, half_width)))
    swept = shapely.MultiPolygon([at(0.0), at(1.0)]).convex_hull
    if fraction == NO_CONTACT:
        assert swept.intersection(car).area < 1e-6
        return
    assert 0.0 <= fraction <= 1.0
    assert at(fraction).distance(car) <= 1e-7
    if fraction > 0.0:
        assert at(fraction).intersection(car).area < 1e-6
        assert all(at(s).distance(car) > 0.0 for s in np.linspace(0.0, 1.0, 30) * fraction * (1.0 - 1e-6))
