"""What RViz and Foxglove are shown is published, as the type that they show, and is where the simulation has it."""

import json
import math
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
import yaml
from rclpy.parameter import Parameter
from skd_adversary.adversary import BelievedCar
from skd_adversary.ros.adversary_node import AdversaryNode, belief_to_odometry
from skd_evaluator.assessment.run.episodes import Samples, run_episode
from skd_evaluator.ros.evaluator import Evaluator
from skd_evaluator.ros.visualization import episode_markers, recorded_figures
from skd_sim import CarState, EpisodeLog, EpisodeSpec, Mode, Outcome, Scenario, load_scenario
from skd_sim.ros.commands import NAMED_FORMATS, message_class, number_paths
from skd_sim.ros.simulator_node import VehicleSimulator
from skd_sim.ros.support import Topic
from skd_sim.scenario.road import ONCOMING, Lane, Road, road_pose
from visualization_msgs.msg import Marker

EVALUATOR = Path(__file__).resolve().parents[2] / "ros_ws" / "src" / "skd_evaluator"
VIEW = EVALUATOR / "rviz" / "skd.rviz"
LAYOUT = EVALUATOR / "foxglove" / "skd.json"


@pytest.fixture(params=sorted(NAMED_FORMATS))
def published(request: pytest.FixtureRequest, domain: int) -> Iterator[dict[str, str]]:
    """Topics that SKD's nodes publish where the car commands by messages of a type, with their types."""
    simulator = VehicleSimulator(parameter_overrides=[Parameter("command_type", value=request.param)])
    nodes = [simulator, AdversaryNode(parameter_overrides=[Parameter("warm_up", value=False)]), Evaluator()]
    yield {one.topic_name: f"{one.msg_type.__module__.split('.')[0]}/msg/{one.msg_type.__name__}"
           for node in nodes for one in node.publishers}  # fmt: skip
    for node in nodes:
        node.destroy_node()


def test_rviz(published: dict[str, str]) -> None:
    manager = yaml.safe_load(VIEW.read_text(encoding="utf-8"))["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == "map"
    shown = set()
    for display in manager["Displays"]:
        kind = display["Class"].partition("/")[2]
        for topic in (display[key] for key in ("Topic", "Description Topic") if key in display):
            shown.add(topic["Value"])
            assert published[topic["Value"]].endswith(f"/{'String' if kind == 'RobotModel' else kind}")
            latched = topic["Value"] in ("/skd/markers", "/robot_description")
            assert topic["Durability Policy"] == ("Transient Local" if latched else "Volatile")
    assert shown >= {"/skd/markers", "/robot_description", "/ego/scan", "/ego/odometry", "/skd/command"}
    assert "rviz_default_plugins/TF" in {display["Class"] for display in manager["Displays"]}


def strings(content: Any) -> list[str]:
    if isinstance(content, dict):
        return [text for key, value in content.items() for text in (*strings(key), *strings(value))]
    if isinstance(content, list):
        return [text for value in content for text in strings(value)]
    return [content] if isinstance(content, str) else []


def test_foxglove(published: dict[str, str]) -> None:
    layout = json.loads(LAYOUT.read_text(encoding="utf-8"))
    panels = layout["configById"]
    assert sorted(text for text in strings(layout["layout"]) if "!" in text) == sorted(panels)
    plotted = [path["value"] for panel in panels.values() for path in panel.get("paths", ())]
    for path in plotted:
        topic, _, field = path.partition(".")
        assert field in number_paths(message_class(published[topic])), path
    assert "/skd/command.accel.linear.x" in plotted
    named = {text.partition(".")[0] for text in strings(panels) if re.match(r"/((skd|ego|adversary)/|robot_)", text)}
    assert named <= published.keys()
    assert [panel["followTf"] for panel in panels.values() if panel.get("followMode") == "follow-pose"] == ["base_link"]


RIGHT_TURN, CROSSING = load_scenario("right_turn"), load_scenario("crossing")


def shown(scenario: Scenario, car: tuple[float, ...] | None, *walked: tuple[float, float]) -> dict[int, Marker]:
    samples = Samples()
    if car is not None:
        samples.car[0] = CarState(*car, 5.0)
    for stamp, place in enumerate(walked):
        samples.adversary[stamp] = place
    return {one.type: one for one in episode_markers(EpisodeSpec(scenario, Mode.SAFE, 0, 0), samples, 0).markers}


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
    found: dict[str, list[float]] = {Topic.CLEARANCE: [], Topic.DEVIATION: []}
    for topic, message, _ in recorded_figures(log, 10**9):
        found[topic].append(message.data)
    return found[Topic.CLEARANCE], found[Topic.DEVIATION]


def test_figures_of_a_recording(expected: EpisodeLog, replay: EpisodeSpec) -> None:
    scenario, log = expected.episode.scenario, expected
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
