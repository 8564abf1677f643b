"""What RViz is shown: the lane's surface, the car turned along it, the adversary as the shape that it is."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from skd_evaluator.assessment.run.assembly import Samples
from skd_evaluator.ros.visualization import episode_markers
from skd_sim.scenario.road import HEADING_NORTH, ONCOMING, Lane, Road, road_pose
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.world.episode import EpisodeSpec, Mode
from skd_sim.world.state import CarState
from visualization_msgs.msg import Marker

RIGHT_TURN, CROSSING = load_scenario("right_turn"), load_scenario("crossing")


def shown(scenario: Scenario, car: tuple[float, float] | None, *walked: tuple[float, float]) -> dict[int, Marker]:
    samples = Samples()
    if car is not None:
        samples.car[0] = CarState(*car, HEADING_NORTH, 5.0)
    for stamp, place in enumerate(walked):
        samples.adversary[stamp] = place
    return {
        marker.type: marker for marker in episode_markers(EpisodeSpec(scenario, Mode.SAFE, 0, 0), samples, 0).markers
    }


def heading(marker: Marker) -> float:
    return 2.0 * math.atan2(marker.pose.orientation.z, marker.pose.orientation.w)


def test_every_lane_is_shown_and_which_way_it_is_driven() -> None:
    """Three of 3.5 m along 80 m, the left one oncoming; lines at four edges, each lane's two, and arrows."""
    road = Road(3.5, lanes=(Lane(-1, direction=ONCOMING), Lane(1)))
    found = shown(replace(CROSSING, road=road), None, (-3.5, 0.0))
    points = np.array([(point.x, point.y) for point in found[Marker.TRIANGLE_LIST].points])
    surface = shapely.union_all([shapely.Polygon(points[i : i + 3]) for i in range(0, len(points), 3)])
    assert surface.equals(shapely.box(-5.25, -40.0, 5.25, 40.0))
    ends = np.array([(point.x, point.y) for point in found[Marker.LINE_LIST].points]).reshape(-1, 2, 2)
    along = ends[ends[:, 0, 0] == ends[:, 1, 0]]
    assert sorted(set(along[:, 0, 0])) == [-5.25, -1.75, 1.75, 5.25]
    tips = [end for end in ends if end[0, 0] != end[1, 0]][::2]  # an arrow's right side, from behind to its tip
    assert {(round(tip[0]), float(np.sign(tip[1] - back[1]))) for back, tip in tips} == {(-4, -1.0), (0, 1.0), (4, 1.0)}
    assert Marker.LINE_LIST not in shown(CROSSING, None, (-3.5, 0.0))


def test_the_car_is_turned_along_the_lane() -> None:
    x, y, along = road_pose(RIGHT_TURN.road.line, -10.0)
    car = shown(RIGHT_TURN, (x, y), (-3.5, 0.0))[Marker.CUBE]
    assert heading(car) == pytest.approx(along)
    assert (car.pose.position.x, car.pose.position.y) == pytest.approx((x, y))  # of the middle, its reference point
    assert (car.scale.x, car.scale.y) == pytest.approx((4.5, 1.8))
