"""What RViz and Foxglove are shown: lanes, the turned car, clearance, deviation, and the belief."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from skd_adversary.adversary import BelievedCar
from skd_adversary.ros.adversary_node import belief_to_odometry
from skd_evaluator.assessment.run.assembly import Samples
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.ros.visualization import episode_markers, recorded_figures
from skd_sim.ros.support import CLEARANCE, DEVIATION
from skd_sim.scenario.road import ONCOMING, Lane, Road, road_pose
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome
from skd_sim.world.state import CarState
from visualization_msgs.msg import Marker

RIGHT_TURN, CROSSING = load_scenario("right_turn"), load_scenario("crossing")


def shown(
    scenario: Scenario, car: tuple[float, float, float] | None, *walked: tuple[float, float]
) -> dict[int, Marker]:
    samples = Samples()
    if car is not None:
        samples.car[0] = CarState(*car, 5.0)
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


def test_the_car_is_turned_as_it_is() -> None:
    """And not along its lane: it may steer."""
    x, y, along = road_pose(RIGHT_TURN.road.line, -10.0)
    car = shown(RIGHT_TURN, (x, y, along + 0.2), (-3.5, 0.0))[Marker.CUBE]
    assert heading(car) == pytest.approx(along + 0.2)
    assert (car.pose.position.x, car.pose.position.y) == pytest.approx((x, y))  # of the middle, its reference point
    assert (car.scale.x, car.scale.y) == pytest.approx((4.5, 1.8))


def figures_of(log: EpisodeLog) -> tuple[list[float], list[float]]:
    """Clearance and deviation in a recording, m."""
    found: dict[str, list[float]] = {CLEARANCE: [], DEVIATION: []}
    for topic, message, _ in recorded_figures(log, 10**9):
        found[topic].append(message.data)
    return found[CLEARANCE], found[DEVIATION]


def test_figures_of_a_recording(expected: EpisodeLog, replay: EpisodeSpec) -> None:
    scenario, log = expected.episode.scenario, expected
    assert log.episode.safe_trajectory is not None
    apart, strayed = figures_of(log)
    assert len(apart) == len(strayed) == len(log.car)
    ends = -1 if log.outcome == Outcome.COLLISION else None
    for found, car, place in list(zip(apart, log.car, log.adversary, strict=True))[:ends]:
        half = scenario.car.half_width
        outline = shapely.box(car[0] - half, car[1] - scenario.car.rear, car[0] + half, car[1] + scenario.car.front)
        assert found == pytest.approx(max(0.0, outline.distance(shapely.Point(place)) - scenario.adversary.radius))
    if log.outcome == Outcome.COLLISION:
        assert apart[-1] == pytest.approx(0.0, abs=1e-6)
    phi = log.episode.safe_trajectory.positions
    held = phi[np.minimum(np.arange(len(log.adversary)), len(phi) - 1)]
    away = np.maximum.accumulate(np.hypot(*(log.adversary - held).T))
    assert strayed[:ends] == pytest.approx(away[:ends].tolist())
    along = figures_of(run_episode(replay))[1]
    assert along == pytest.approx([0.0] * len(along), abs=1e-9)


def test_a_belief_is_odometry_along_the_road(replay: EpisodeSpec) -> None:
    message = belief_to_odometry(BelievedCar(-7.0, 0.5, 6.0, 0.25), replay, 3_000_000_000)
    x, y, heading = road_pose(replay.scenario.road.line, -7.0)
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    assert (place.x, place.y, 2.0 * math.atan2(turn.z, turn.w)) == pytest.approx((x, y, heading))
    assert message.header.frame_id == "map"
    assert message.twist.twist.linear.x == 6.0
    covariance = np.array(message.pose.covariance).reshape(6, 6)
    assert np.linalg.eigvalsh(covariance)[-1] == pytest.approx(0.25)
    assert covariance[1, 1] == pytest.approx(0.25)  # the road leads North
    assert message.twist.covariance[0] == pytest.approx(0.0625)
