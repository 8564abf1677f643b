"""The laser, and the car's description for other programs."""

import math
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest
import shapely
import shapely.affinity
from hypothesis import given, settings
from hypothesis import strategies as st
from skd_sim.options.options import Frames
from skd_sim.ros.simulator_node import robot_description
from skd_sim.scenario.road import HEADING_NORTH
from skd_sim.scenario.scenario import Obstacle, Scenario, load_scenario, scenario_from_dict
from skd_sim.scenario.scenario_file import shipped_scenarios
from skd_sim.world.sensors import Inertia, InertialUnit, PlanarLaser, rectangle_range
from skd_sim.world.state import AdversaryState, CarState

CROSSING = load_scenario("crossing")
NOWHERE = AdversaryState(1e6, 1e6, 0.0, 0.0)


def scenario(*obstacles: Obstacle, **sensor: float) -> Scenario:
    assert CROSSING.sensor is not None
    return replace(CROSSING, sensor=replace(CROSSING.sensor, **sensor), obstacles=obstacles)


def ray(bearing: float, length: float) -> shapely.LineString:
    return shapely.LineString([(0.0, 0.0), (length * math.cos(bearing), length * math.sin(bearing))])


def first_hit(shape: shapely.Geometry, bearing: float) -> float:
    """The range by shapely: nearest point of the ray inside of the shape."""
    hit = ray(bearing, 100.0).intersection(shape)
    return math.inf if hit.is_empty else shapely.Point(0.0, 0.0).distance(hit)


finite = {"allow_nan": False, "allow_infinity": False}
centres = st.floats(-20.0, 20.0, **finite)
angles = st.floats(-math.pi, math.pi, **finite)


def test_a_laser_all_around_may_begin_ahead():
    """As a TurtleBot's: one beam a degree, to the left, the first straight ahead."""
    sensor = {"beams": 360, "field_of_view": math.radians(359.0), "range_noise": 0.0, "dropout": 0.0}
    around = scenario(Obstacle(-5.0, 0.0, HEADING_NORTH, 2.0, 2.0), **sensor, first_bearing=0.0, mount_ahead=0.0)
    assert scenario_from_dict(around.as_dict()) == around
    scan = PlanarLaser(around, 0, 0).scan(CarState(0.0, 0.0, HEADING_NORTH, 0.0), AdversaryState(0.0, 8.0, 0, 0), 0)
    assert scan.angle_min == 0.0
    assert np.flatnonzero(np.isfinite(scan.ranges)).tolist() == [0, 1, *range(76, 105), 359]
    assert (scan.ranges[0], scan.ranges[90]) == pytest.approx((7.75, 4.0))


@settings(max_examples=200)
@given(centres, centres, angles, st.floats(0.1, 4.0), st.floats(0.1, 4.0), angles)
def test_rectangle_against_shapely(x, y, heading, half_length, half_width, bearing):
    box = shapely.box(x - half_length, y - half_width, x + half_length, y + half_width)
    box = shapely.affinity.rotate(box, heading, origin=(x, y), use_radians=True)
    margin = 1e-6
    if ray(bearing, 100.0).intersects(box.buffer(margin)) != ray(bearing, 100.0).intersects(box.buffer(-margin)):
        return  # grazes
    found = rectangle_range(x, y, heading, half_length, half_width, math.cos(bearing), math.sin(bearing))
    assert found == pytest.approx(first_hit(box, bearing), abs=1e-6)


def test_the_whole_fan_against_shapely_with_a_turned_car():
    car, adversary = CarState(2.0, -7.0, 1.1, 5.0), AdversaryState(4.5, 1.0, 0.0, 0.0)
    parked = Obstacle(-1.0, 2.0, 0.4, 4.3, 1.8), Obstacle(6.0, 3.0, -1.2, 2.0, 1.0)
    chosen = scenario(*parked, beams=91)
    ranges = PlanarLaser(chosen, 0, 0).true_ranges(car, adversary)
    mount = chosen.sensor.mount_ahead
    sensor = car.x + mount * math.cos(car.heading), car.y + mount * math.sin(car.heading)
    shapes = [shapely.Point(adversary.x, adversary.y).buffer(0.25, quad_segs=2000)]
    for item in parked:
        box = shapely.box(-item.length / 2, -item.width / 2, item.length / 2, item.width / 2)
        box = shapely.affinity.rotate(box, item.heading, origin=(0, 0), use_radians=True)
        shapes.append(shapely.affinity.translate(box, item.x, item.y))
    shape = shapely.affinity.translate(shapely.union_all(shapes), -sensor[0], -sensor[1])
    bearings = car.heading + np.linspace(-math.pi / 2, math.pi / 2, 91)
    expected = np.array([first_hit(shape, bearing) for bearing in bearings])
    assert np.isfinite(expected).sum() > 20
    np.testing.assert_allclose(ranges, expected, atol=1e-4)


def test_a_guard_rail_hides_nobody_and_blocks_ways():
    """Beside a wall in the same place that hides, and beside none."""
    car, behind = CarState(0.0, -10.0, math.pi / 2, 8.0), AdversaryState(0.0, 0.0, 0.0, 0.0)
    rail, wall = (Obstacle(0.0, -3.0, 0.0, 3.0, 1.0, hides) for hides in (False, None))
    seen = [PlanarLaser(scenario(*one), 0, 0).true_ranges(car, behind) for one in ((rail, wall), (wall,), (rail,), ())]
    assert np.array_equal(seen[0], seen[1])
    assert np.array_equal(seen[2], seen[3])
    assert not np.array_equal(seen[1], seen[2])
    assert np.array_equal(scenario(rail).rectangles, scenario(wall).rectangles)
    data = {**CROSSING.as_dict(), "obstacles": [{"x": 4.0, "y": -3.0, "heading": 0.0, "length": 2.0, "width": 1.0}]}
    assert "hides" not in scenario_from_dict(data).as_dict()["obstacles"][0]
    data["obstacles"][0]["hides"] = False
    assert scenario_from_dict(data).as_dict()["obstacles"][0]["hides"] is False


def test_noise_and_dropouts_have_the_stated_distribution():
    """A wall around the car: every beam returns. Bounds are five standard errors."""
    wall = Obstacle(0.0, 0.0, 0.0, 30.0, 30.0)
    laser = PlanarLaser(scenario(wall, beams=4001, range_noise=0.05, dropout=0.1), 3, 1)
    car = CarState(0.0, -20.0 - CROSSING.car.front, HEADING_NORTH, 0.0)  # the wall's face is 5 m ahead
    true = laser.true_ranges(car, NOWHERE)
    hits = np.isfinite(true)
    noise, lost = [], 0
    for tick in range(20):
        measured = laser.scan(car, NOWHERE, tick).ranges
        assert np.isposinf(measured[~hits]).all()
        lost += int(np.isinf(measured[hits]).sum())
        noise.append(measured[np.isfinite(measured)] - true[np.isfinite(measured)])
    total, errors = 20 * int(hits.sum()), np.concatenate(noise)
    assert total > 20_000
    assert lost / total == pytest.approx(0.1, abs=5 * math.sqrt(0.09 / total))
    assert errors.mean() == pytest.approx(0.0, abs=5 * 0.05 / math.sqrt(len(errors)))
    assert errors.std() == pytest.approx(0.05, abs=5 * 0.05 / math.sqrt(2 * len(errors)))


def test_a_scan_depends_on_seed_episode_and_tick_and_on_nothing_else():
    car, adversary = CarState(0.0, -12.0, HEADING_NORTH, 5.0), AdversaryState(0.0, 0.0, 0.0, 0.0)
    laser = PlanarLaser(CROSSING, 5, 7)
    late = laser.scan(car, adversary, 9)
    for tick in range(10):
        laser.scan(car, adversary, tick)
    assert laser.scan(car, adversary, 9).ranges.tobytes() == late.ranges.tobytes()
    assert late.ranges.dtype == np.float32
    for seed, episode, tick in ((6, 7, 9), (5, 8, 9), (5, 7, 8)):
        other = PlanarLaser(CROSSING, seed, episode).scan(car, adversary, tick)
        assert other.ranges.tobytes() != late.ranges.tobytes()


GRAVITY = 9.80665  # m/s², 3rd CGPM (1901)
MILLISECOND = 1_000_000  # ns


def measured(*states: tuple[int, CarState]) -> list[Inertia]:
    unit = InertialUnit()
    return [unit.measure(car, stamp) for stamp, car in states]


@given(heading=st.floats(-3.0, 3.0), speed=st.floats(0.0, 20.0), period=st.integers(5, 300))
def test_without_forces_there_is_only_gravity(heading, speed, period):
    """REP 145: an accelerometer at rest, or in uniform motion, shows g upwards."""
    cars = [(tick * period * MILLISECOND, CarState(0.0, 0.0, heading, speed)) for tick in range(3)]
    assert measured(*cars) == [Inertia(heading, 0.0, (0.0, 0.0, GRAVITY))] * 3


@given(speed=st.floats(1.0, 20.0), radius=st.floats(5.0, 100.0), left=st.booleans(), start=st.floats(-3.1, 3.1))
def test_a_circle(speed, radius, left, start):
    """v/r and v²/r, to the inside, across the jump of the heading at π, too."""
    rate = speed / radius if left else -speed / radius
    headings = [math.remainder(start + rate * 0.05 * k, 2.0 * math.pi) for k in range(20)]
    cars = [(50 * MILLISECOND * k, CarState(0.0, 0.0, heading, speed)) for k, heading in enumerate(headings)]
    for inertia in measured(*cars)[1:]:
        assert inertia.yaw_rate == pytest.approx(rate, rel=1e-9)
        assert inertia.acceleration == pytest.approx((0.0, speed * rate, GRAVITY), rel=1e-9)


def numbers(element: ElementTree.Element | None, key: str) -> list[float]:
    return [float(word) for word in element.attrib[key].split()]


@pytest.mark.parametrize("name", sorted(shipped_scenarios()))
@pytest.mark.parametrize("part", ["visual", "collision"])
def test_the_body_is_the_footprint_on_the_ground(name: str, part: str) -> None:
    scenario = load_scenario(name)
    body = ElementTree.fromstring(robot_description(scenario)).find(f"link[@name='base_link']/{part}")
    middle, size = numbers(body.find("origin"), "xyz"), numbers(body.find("geometry/box"), "size")
    low = [at - 0.5 * extent for at, extent in zip(middle, size, strict=True)]
    high = [at + 0.5 * extent for at, extent in zip(middle, size, strict=True)]
    car = scenario.car
    assert (low[0], high[0]) == pytest.approx((-car.rear, car.front))
    assert (low[1], high[1]) == pytest.approx((-0.5 * car.width, 0.5 * car.width))
    assert low[2] == 0.0


def test_the_links_are_a_tree_of_fixed_joints() -> None:
    robot = ElementTree.fromstring(robot_description(load_scenario("crossing"), Frames(base="car/body", laser="front")))
    assert robot.tag == "robot"
    assert {link.attrib["name"] for link in robot.findall("link")} == {"car/body", "front"}
    (joint,) = robot.findall("joint")
    assert joint.attrib["type"] == "fixed"
    assert [joint.find(end).attrib["link"] for end in ("parent", "child")] == ["car/body", "front"]  # type: ignore[union-attr]
    assert numbers(joint.find("origin"), "xyz")[:2] == [2.25, 0.0]  # sensor.mount_ahead: the bumper of a car of 4.5 m
