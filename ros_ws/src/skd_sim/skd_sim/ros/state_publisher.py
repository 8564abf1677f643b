"""What a stack hears: clock, transforms, odometries, measurements of the car's sensors, start pose and shape.

Each goes out only while a node listens. Adversary and others are tracked objects of vision_msgs, where that package
is installed. The car's shape is a URDF: its body is the footprint of the scenario's car, as high as it is drawn. There
are no movable joints, since nothing is known of the wheels; so no `/joint_states` are needed either.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from xml.sax.saxutils import quoteattr

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, LaserScan, PointCloud2
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from skd_sim.options.options import ADVERSARY_FRAME, FRAMES, MAP_FRAME, Frames, StateOptions
from skd_sim.ros import to_messages
from skd_sim.ros.support import LATCHED, STREAM, Topic
from skd_sim.scenario.road_user import Body, height_of
from skd_sim.scenario.scenario import Scenario
from skd_sim.simulators.simulator import Frame
from skd_sim.world.episode import EpisodeSpec
from skd_sim.world.sensors import InertialUnit, PlanarLaser, make_laser
from skd_sim.world.state import CarState, RoadUserState, Scene


class StatePublisher:
    """Publishes the states of one episode after another."""

    def __init__(self, node: Node, options: StateOptions, *, clock: bool, initial_pose: bool = False) -> None:
        """Make the topics.

        Args:
            node: node that publishes.
            options: how the states are published.
            clock: whether `/clock` is among them.
            initial_pose: whether the car's start pose is among them; a node that subscribes later gets it, too.
        """
        self._frames = Frames(options.odom_frame, options.base_frame, options.laser_frame)
        self._scan_rate = options.scan_rate
        self._with_map = not options.own_localisation
        streams: dict[str, Any] = {
            Topic.TF: TFMessage,
            Topic.EGO_IMU: Imu,
            Topic.EGO_SCAN: LaserScan,
            Topic.EGO_POINTS: PointCloud2,
            Topic.EGO_ODOMETRY: Odometry,
            Topic.ADVERSARY_ODOMETRY: Odometry,
        }
        latched: dict[str, Any] = {Topic.TF_STATIC: TFMessage, Topic.ROBOT_DESCRIPTION: String}
        if clock:
            streams[Topic.CLOCK] = Clock
        if initial_pose:
            latched[INITIAL_POSE] = PoseWithCovarianceStamped
        if DETECTIONS is None:
            node.get_logger().info(f"vision_msgs is not installed, so there is no topic {Topic.ADVERSARY_DETECTIONS}")
        else:
            streams[Topic.ADVERSARY_DETECTIONS] = DETECTIONS
        self._streams = {topic: node.create_publisher(kind, topic, STREAM) for topic, kind in streams.items()}
        self._latched = {topic: node.create_publisher(kind, topic, LATCHED) for topic, kind in latched.items()}
        self._described: tuple[Any, ...] = ()

    def begin(self, episode: EpisodeSpec, car: CarState, stamp: int) -> None:
        """Begin an episode with the car at its start at a stamp (ns); its looks come again if they have changed."""
        self._scenario = scenario = episode.scenario
        self._laser: PlanarLaser | None = make_laser(episode)
        self._inertial_unit = InertialUnit()
        self._moved = -1, 0
        self._scan_every = 1
        if self._scan_rate:
            self._scan_every = max(1, round(1.0 / (self._scan_rate * scenario.control_duration)))
        if INITIAL_POSE in self._latched:
            self._latched[INITIAL_POSE].publish(initial_pose(car, stamp))
        described = (scenario.car, scenario.sensor)
        if described != self._described:
            self._described = described
            mount = None if scenario.sensor is None else (scenario.sensor.mount_ahead, 0.0, LASER_HEIGHT)
            fixed = to_messages.static_transforms(mount, stamp, self._frames, with_map=self._with_map)
            self._latched[Topic.TF_STATIC].publish(fixed)
            self._latched[Topic.ROBOT_DESCRIPTION].publish(String(data=robot_description(scenario, self._frames)))

    def tell_time(self, stamp: int) -> None:
        """Publish the clock, ns."""
        self._send(Topic.CLOCK, lambda: Clock(clock=to_messages.to_stamp(stamp)))

    def publish(self, frame: Frame, stamp: int) -> None:
        """Publish a state of the episode at its stamp (ns); it may be published repeatedly."""
        scenario, frames = self._scenario, self._frames
        listeners = self._streams[Topic.TF].get_subscription_count()
        # tf2 complains of a transform that comes twice; a listener that came since then needs it.
        if (stamp, listeners) != self._moved:
            self._send(Topic.TF, lambda: to_messages.scene_to_transforms(frame.scene(scenario), stamp, frames))
        self._moved = stamp, listeners
        inertia = self._inertial_unit.measure(frame.car, stamp)  # of every state, or it would depend on who listens
        self._send(Topic.EGO_IMU, lambda: to_messages.inertia_to_message(inertia, stamp, frames))
        if not (frame.tick * scenario.control_periods + frame.period) % self._scan_every:
            self._publish_scan(frame, stamp)
        self._send(Topic.ADVERSARY_DETECTIONS, lambda: detections(scenario, frame.scene(scenario), stamp, frames.odom))
        self._send(Topic.EGO_ODOMETRY, lambda: to_messages.car_to_odometry(frame.car, stamp, frames))
        self._send(Topic.ADVERSARY_ODOMETRY, lambda: to_messages.adversary_to_odometry(frame.adversary, stamp))

    def _publish_scan(self, frame: Frame, stamp: int) -> None:
        heard = any(self._streams[topic].get_subscription_count() for topic in (Topic.EGO_SCAN, Topic.EGO_POINTS))
        if self._laser is not None and heard:
            scan = self._laser.scan(frame.car, frame.adversary, frame.tick, frame.period)
            self._send(Topic.EGO_SCAN, lambda: to_messages.scan_to_message(scan, stamp, self._frames))
            self._send(Topic.EGO_POINTS, lambda: to_messages.scan_to_points(scan, stamp, self._frames))

    def _send(self, topic: str, make: Callable[[], Any]) -> None:
        publisher = self._streams.get(topic)
        if publisher is not None and publisher.get_subscription_count():
            publisher.publish(make())


CAR_HEIGHT = 1.5
"""Of the body, m; it is looked at only."""
LASER_HEIGHT = 0.3
"""Of the scanner above the ground, m: the world is flat, but filters by height take what lies at 0 for the road."""


def robot_description(scenario: Scenario, frames: Frames = FRAMES) -> str:
    """Return the URDF of a scenario's car, and of its laser where it has one.

    Args:
        scenario: gives footprint and sensor.
        frames: names of the links.
    """
    car, sensor = scenario.car, scenario.sensor
    body = f'<box size="{car.front + car.rear} {car.width} {CAR_HEIGHT}"/>'
    middle = f"{0.5 * (car.front - car.rear)} 0.0 {0.5 * CAR_HEIGHT}"
    parts = [_link(frames.base, middle, body, "0.29 0.44 0.65 0.9")]
    if sensor is not None:
        base, laser = quoteattr(frames.base), quoteattr(frames.laser)
        parts.append(_link(frames.laser, "0.0 0.0 0.0", '<cylinder radius="0.05" length="0.07"/>', "0.1 0.1 0.1 1.0"))
        parts.append(
            f"""  <joint name={quoteattr(f"{frames.laser}_mount")} type="fixed">
    <parent link={base}/>
    <child link={laser}/>
    <origin xyz="{sensor.mount_ahead} 0.0 {LASER_HEIGHT}" rpy="0 0 0"/>
  </joint>
"""
        )
    return f'<?xml version="1.0"?>\n<robot name="car_under_test">\n{"".join(parts)}</robot>\n'


def _link(name: str, middle: str, shape: str, colour: str) -> str:
    origin = f'<origin xyz="{middle}" rpy="0 0 0"/><geometry>{shape}</geometry>'
    material = f'<material name={quoteattr(f"{name}_colour")}><color rgba="{colour}"/></material>'
    return f"""  <link name={quoteattr(name)}>
    <visual>{origin}{material}</visual>
    <collision>{origin}</collision>
  </link>
"""


INITIAL_POSE = "initialpose"
_DIAGONAL = (0, 7, 35)  # x, y and yaw in a covariance of 6 × 6, row by row


def initial_pose(car: CarState, stamp: int) -> PoseWithCovarianceStamped:
    """Return where the car starts, with a stamp (ns); exact, but a variance of zero would say that it is not known."""
    message = PoseWithCovarianceStamped(header=to_messages.header(stamp, MAP_FRAME))
    message.pose.pose.position.x, message.pose.pose.position.y = car.x, car.y
    message.pose.pose.orientation = to_messages.to_orientation(car.heading)
    for place in _DIAGONAL:
        message.pose.covariance[place] = to_messages.COVARIANCE_6[place]
    return message


try:
    from vision_msgs.msg import Detection3D, Detection3DArray, ObjectHypothesisWithPose
except ImportError:  # ROS 2's base installation lacks it
    Detection3DArray = None

DETECTIONS: type | None = Detection3DArray
"""Type of the messages; none where the package is missing."""


def detections(scenario: Scenario, scene: Scene, stamp: int, frame_id: str) -> Any:
    """Return a Detection3DArray with the adversary and the others; velocities have no place in that message.

    Args:
        scenario: gives kinds, which are the classes, and shapes; the box of a disc is as wide as the disc.
        scene: true states.
        stamp: time stamp, ns.
        frame_id: frame in which the states are.
    """
    found = [_detection(ADVERSARY_FRAME, scenario.adversary, scene.adversary)]
    for index, (other, state) in enumerate(zip(scenario.others, scene.others, strict=True)):
        found.append(_detection(f"other_{index}", other, state))
    head = to_messages.header(stamp, frame_id)
    for one in found:
        one.header = head
    return Detection3DArray(header=head, detections=found)


def _detection(track: str, body: Body, state: RoadUserState) -> Any:
    detection, result = Detection3D(id=track), ObjectHypothesisWithPose()
    result.hypothesis.class_id, result.hypothesis.score = body.kind, 1.0
    height = height_of(body.kind)
    box, size = detection.bbox.center, detection.bbox.size
    box.position.x, box.position.y, box.position.z = state.x, state.y, 0.5 * height
    box.orientation = to_messages.to_orientation(state.heading)
    radius, half_length, half_width = body.shape
    size.x, size.y, size.z = 2.0 * (radius or half_length), 2.0 * (radius or half_width), height
    result.pose.pose, result.pose.covariance = box, to_messages.COVARIANCE_6
    detection.results = [result]
    return detection
