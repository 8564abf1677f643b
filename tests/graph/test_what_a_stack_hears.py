"""What any stack can hear: frames that hang together, rates, quality of service, and that nothing is made in vain."""

import dataclasses
import math
from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import rclpy
from common import wait_until
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, LaserScan, PointCloud2
from skd_sim import EpisodeSpec, Frame, Mode, WorldSimulator, load_scenario
from skd_sim.options.options import StateOptions
from skd_sim.ros.from_messages import odometry_to_adversary
from skd_sim.ros.simulator_node import StatePublisher
from skd_sim.world.episode import period_stamp
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

START = 5_000_000_000
MOVING = {
    "/clock": Clock,
    "/tf": TFMessage,
    "/ego/odometry": Odometry,
    "/ego/imu": Imu,
    "/ego/scan": LaserScan,
    "/ego/points": PointCloud2,
    "/adversary/odometry": Odometry,
}
FIXED = {"/tf_static": TFMessage, "/robot_description": String}
RELIABLE = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def sharp(name: str, **changes: Any) -> EpisodeSpec:
    """An episode whose laser has no noise, with ten states a second and more."""
    scenario = load_scenario(name)
    sensor = dataclasses.replace(scenario.sensor, range_noise=0.0, dropout=0.0)
    return EpisodeSpec(dataclasses.replace(scenario, sensor=sensor, control_period=0.05, **changes), Mode.SAFE, 0, 0)


def states(episode: EpisodeSpec, count: int) -> list[tuple[Frame, int]]:
    """Frames and stamps of a car that brakes and an adversary who walks."""
    simulator, scenario = WorldSimulator(), episode.scenario
    frames = [simulator.reset(episode)]
    while len(frames) < count:
        frames.append(simulator.step(-1.0, (2.0, 0.5)))
    step, periods = scenario.time_step, scenario.control_periods
    return [(frame, period_stamp(START, frame.tick, frame.period, periods, step)) for frame in frames]


class Ears:
    """Two nodes: one that publishes states, one that hears them."""

    def __init__(self, **settings: Any) -> None:
        self.speaker, self.listener = (rclpy.create_node(name) for name in ("speaker", "listener"))
        self.states = StatePublisher(self.speaker, StateOptions(**settings), clock=True)
        self.heard: dict[str, list[Any]] = defaultdict(list)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.listener)

    def listen(self, topics: dict[str, type], profile: Any) -> None:
        ends = [
            self.listener.create_subscription(kind, topic, self.heard[topic].append, profile)
            for topic, kind in topics.items()
        ]
        of_speaker = {publisher.topic_name: publisher for publisher in self.speaker.publishers}
        wait_until(lambda: all(of_speaker[topic].get_subscription_count() for topic in topics))
        wait_until(lambda: all(end.get_publisher_count() for end in ends))  # both have to know each other

    def say(self, frame: Frame, stamp: int) -> None:
        self.states.tell_time(stamp)
        self.states.publish(frame, stamp)

    def wait_for(self, topic: str, count: int) -> list[Any]:
        def there() -> bool:
            self._executor.spin_once(timeout_sec=0.05)
            return len(self.heard[topic]) >= count

        wait_until(there, f"{count} messages on {topic}")
        senders = [one.node_name for one in self.listener.get_publishers_info_by_topic(topic)]
        assert (len(self.heard[topic]), senders) == (count, ["speaker"])  # or somebody else is in this domain
        return self.heard[topic]

    def close(self) -> None:
        self._executor.shutdown()
        for node in (self.speaker, self.listener):
            node.destroy_node()


@pytest.fixture
def ears(domain: int) -> Iterator[Any]:
    made: list[Ears] = []

    def make(**settings: Any) -> Ears:
        made.append(Ears(**settings))
        return made[-1]

    yield make
    for one in made:
        one.close()


def pose_of(transform: Any) -> np.ndarray:
    """A transform as a matrix in the plane."""
    moved = transform.transform
    angle = 2.0 * math.atan2(moved.rotation.z, moved.rotation.w)
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([[cos, -sin, moved.translation.x], [sin, cos, moved.translation.y], [0.0, 0.0, 1.0]])


def points_of(message: PointCloud2) -> np.ndarray:
    assert [(field.name, field.offset, field.datatype) for field in message.fields] == [
        ("x", 0, 7), ("y", 4, 7), ("z", 8, 7)
    ]  # fmt: skip
    return np.frombuffer(bytes(message.data), "<f4").reshape(message.width, 3)


@pytest.mark.parametrize("profile", [RELIABLE, qos_profile_sensor_data], ids=["reliable", "sensor data"])
def test_whoever_listens_hears_all_states_and_every_second_scan(ears: Any, profile: Any) -> None:
    episode = sharp("right_turn" if profile is RELIABLE else "crossing")
    moments = states(episode, 5)
    graph = ears(scan_rate=10.0)
    graph.listen(MOVING, profile)
    graph.states.begin(episode, moments[0][0].car, START)
    graph.listen(FIXED, LATCHED)  # after they were said
    for frame, stamp in moments:
        graph.say(frame, stamp)
    stamps = [stamp for _, stamp in moments]
    for topic in MOVING:
        wanted = stamps[::2] if topic in ("/ego/scan", "/ego/points") else stamps
        messages = graph.wait_for(topic, len(wanted))
        first = [message.transforms[0] if topic == "/tf" else message for message in messages]
        times = [message.clock if topic == "/clock" else message.header.stamp for message in first]
        assert [time.sec * 10**9 + time.nanosec for time in times] == wanted, topic
    (fixed,) = graph.wait_for("/tf_static", 1)
    tree = {one.child_frame_id: one for one in [*fixed.transforms, *graph.heard["/tf"][-1].transforms]}
    parents = {"odom": "map", "base_link": "odom", "laser": "base_link", "adversary": "map"}
    parents |= {f"other_{number}": "map" for number in range(len(episode.scenario.others))}
    assert {child: one.header.frame_id for child, one in tree.items()} == parents
    assert "<robot" in graph.wait_for("/robot_description", 1)[0].data

    # what the laser sees, carried from frame to frame into the map, lies on the adversary
    radius = episode.scenario.adversary.radius
    seen = points_of(graph.heard["/ego/points"][-1])
    in_map = pose_of(tree["odom"]) @ pose_of(tree["base_link"]) @ pose_of(tree["laser"])
    places = (in_map @ np.column_stack([seen[:, :2], np.ones(len(seen))]).T)[:2].T
    adversary = moments[-1][0].adversary
    assert len(places) > 3
    np.testing.assert_allclose(np.hypot(places[:, 0] - adversary.x, places[:, 1] - adversary.y), radius, atol=1e-4)

    odometry, imu = graph.heard["/ego/odometry"], graph.heard["/ego/imu"]
    assert {(message.header.frame_id, message.child_frame_id) for message in odometry} == {("odom", "base_link")}
    assert {message.header.frame_id for message in imu} == {"base_link"}
    assert {message.header.frame_id for message in graph.heard["/ego/scan"]} == {"laser"}
    for covariance in (odometry[0].pose.covariance, odometry[0].twist.covariance):
        assert np.all(np.linalg.eigvalsh(np.reshape(covariance, (6, 6))) > 0.0)  # can be inverted
    speeds = [message.twist.twist.linear.x for message in odometry]
    felt = [message.linear_acceleration.x for message in imu]
    np.testing.assert_allclose(felt[1:], np.diff(speeds) / 0.05, rtol=1e-6, atol=1e-9)


def test_the_adversary_is_a_tracked_object(ears: Any) -> None:
    """Its twist is in its own frame, which has a transform, and gives the velocity in the map to the last bit."""
    vision = pytest.importorskip("vision_msgs.msg")
    episode = sharp("cyclist")
    adversary = episode.scenario.adversary
    moments = states(episode, 5)  # the depth of that quality of service
    graph = ears()
    heard = {"/adversary/odometry": Odometry, "/adversary/detections": vision.Detection3DArray, "/tf": TFMessage}
    graph.listen(heard, qos_profile_sensor_data)
    graph.states.begin(episode, moments[0][0].car, START)
    for frame, stamp in moments:
        graph.say(frame, stamp)
    messages, transforms = graph.wait_for("/adversary/odometry", len(moments)), graph.wait_for("/tf", len(moments))
    for message, moved, (frame, _) in zip(messages, transforms, moments, strict=True):
        (transform,) = [one for one in moved.transforms if one.child_frame_id == message.child_frame_id]
        turned = pose_of(transform)
        twist, state = message.twist.twist.linear, frame.adversary
        np.testing.assert_allclose(turned[:2, :2] @ [twist.x, twist.y], [state.vx, state.vy], atol=1e-12)
        np.testing.assert_array_equal(turned[:2, 2], [state.x, state.y])
        assert odometry_to_adversary(message) == state
    assert twist.x == pytest.approx(math.hypot(2.0, 0.5))
    assert twist.y == pytest.approx(0.0, abs=1e-9)
    messages = graph.wait_for("/adversary/detections", len(moments))
    assert len({message.detections[0].id for message in messages}) == 1
    for message, (frame, _) in zip(messages, moments, strict=True):
        (detection,) = message.detections
        assert message.header == detection.header
        assert message.header.frame_id == "odom"
        assert detection.results[0].hypothesis.class_id == adversary.kind == "cyclist"
        centre, size = detection.bbox.center, detection.bbox.size
        assert (centre.position.x, centre.position.y) == (frame.adversary.x, frame.adversary.y)
        heading = 2.0 * math.atan2(centre.orientation.z, centre.orientation.w)
        assert heading == pytest.approx(frame.adversary.heading)
        assert (size.x, size.y) == (adversary.length, adversary.width)
        assert centre.position.z == 0.5 * size.z


def test_the_frames_of_a_stack_that_calls_them_otherwise(ears: Any) -> None:
    """And that localises itself, so that map → odom is its own."""
    graph = ears(odom_frame="car/odom", base_frame="car/base", laser_frame="car/front", own_localisation=True)
    graph.listen({"/ego/odometry": Odometry, "/tf": TFMessage, "/ego/scan": LaserScan}, RELIABLE)
    episode = sharp("crossing")
    frame, stamp = states(episode, 1)[0]
    graph.states.begin(episode, frame.car, START)
    graph.listen(FIXED, LATCHED)
    graph.say(frame, stamp)
    (fixed,), (moving,) = graph.wait_for("/tf_static", 1), graph.wait_for("/tf", 1)
    pairs = [(one.header.frame_id, one.child_frame_id) for one in [*fixed.transforms, *moving.transforms]]
    assert pairs == [("car/base", "car/front"), ("car/odom", "car/base"), ("map", "adversary")]
    (odometry,), (scan,) = graph.wait_for("/ego/odometry", 1), graph.wait_for("/ego/scan", 1)
    assert (odometry.header.frame_id, odometry.child_frame_id) == pairs[1]
    assert scan.header.frame_id == "car/front"
    assert 'name="car/front"' in graph.wait_for("/robot_description", 1)[0].data
