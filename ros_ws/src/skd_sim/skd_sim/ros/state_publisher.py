"""What a stack hears: clock, transforms, odometries, measurements of the car's sensors, start pose and shape.

Each goes out only while a node listens. Adversary and others are tracked objects of vision_msgs, where that package
is installed. The car's shape is a URDF: its body is the footprint of the scenario's car, as high as it is drawn. There
are no movable joints, since nothing is known of the wheels; so no `/joint_states` are needed either.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, LaserScan, PointCloud2
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from skd_sim.options.options import FRAMES, MAP_FRAME, Frames, StateOptions
from skd_sim.ros.support import (
    ADVERSARY_DETECTIONS,
    ADVERSARY_ODOMETRY,
    CLOCK,
    EGO_IMU,
    EGO_ODOMETRY,
    EGO_POINTS,
    EGO_SCAN,
    LATCHED,
    ROBOT_DESCRIPTION,
    STREAM,
    TF,
    TF_STATIC,
)
from skd_sim.ros.to_messages import (
    COVARIANCE_6,
    adversary_to_odometry,
    car_to_odometry,
    inertia_to_message,
    scan_to_message,
    scan_to_points,
    scene_to_transforms,
    static_transforms,
    to_orientation,
    to_stamp,
)
from skd_sim.scenario.road_user import Body, height_of
from skd_sim.scenario.scenario import Scenario
from skd_sim.simulators.simulator import Frame
from skd_sim.world.episode import EpisodeSpec
from skd_sim.world.sensors import InertialUnit, PlanarLaser, make_laser
from skd_sim.world.state import CarState, RoadUserState, Scene


class StatePublisher:
    """Publishes the states of one episode after another."""

    def __init__(self, node: Node, options: StateOptions, *, clock: bool) -> None:
        """Make the topics.

        Args:
            node: node that publishes.
            options: how the states are published.
            clock: whether `/clock` is among them.
        """
        self._frames = Frames(options.odom_frame, options.base_frame, options.laser_frame)
        self._scan_rate = options.scan_rate
        self._with_map = not options.own_localisation
        self._clock = node.create_publisher(Clock, CLOCK, STREAM) if clock else None
        self._transform = node.create_publisher(TFMessage, TF, STREAM)
        self._static_transforms = node.create_publisher(TFMessage, TF_STATIC, LATCHED)
        self._description = node.create_publisher(String, ROBOT_DESCRIPTION, LATCHED)
        self._car = node.create_publisher(Odometry, EGO_ODOMETRY, STREAM)
        self._imu = node.create_publisher(Imu, EGO_IMU, STREAM)
        self._scan = node.create_publisher(LaserScan, EGO_SCAN, STREAM)
        self._points = node.create_publisher(PointCloud2, EGO_POINTS, STREAM)
        self._adversary = node.create_publisher(Odometry, ADVERSARY_ODOMETRY, STREAM)
        self._detections: Any = None
        if DETECTIONS is None:
            node.get_logger().info(f"vision_msgs is not installed, so there is no topic {ADVERSARY_DETECTIONS}")
        else:
            self._detections = node.create_publisher(DETECTIONS, ADVERSARY_DETECTIONS, STREAM)
        self._described: tuple[Any, ...] = ()

    def begin(self, episode: EpisodeSpec, stamp: int) -> None:
        """Begin an episode at a stamp (ns); latched topics are published again if the car has changed."""
        self._episode = episode
        self._laser: PlanarLaser | None = make_laser(episode)
        self._inertial_unit = InertialUnit()
        self._moved = -1, 0
        scenario = episode.scenario
        self._periods = scenario.control_periods
        self._scan_every = 1
        if self._scan_rate:
            self._scan_every = max(1, round(1.0 / (self._scan_rate * scenario.control_duration)))
        described = (scenario.car, scenario.sensor)
        if described != self._described:
            self._described = described
            mount = None if scenario.sensor is None else laser_mount(scenario)
            self._static_transforms.publish(static_transforms(mount, stamp, self._frames, with_map=self._with_map))
            self._description.publish(String(data=robot_description(scenario, self._frames)))

    def tell_time(self, stamp: int) -> None:
        """Publish the clock, ns."""
        if self._clock is not None and self._clock.get_subscription_count():
            self._clock.publish(Clock(clock=to_stamp(stamp)))

    def publish(self, frame: Frame, stamp: int) -> None:
        """Publish a state of the episode at its stamp (ns); it may be published repeatedly."""
        listeners = self._transform.get_subscription_count()
        # tf2 complains of a transform that comes twice; a listener that came since then needs it.
        if listeners and (stamp, listeners) != self._moved:
            self._transform.publish(scene_to_transforms(frame.scene(self._episode.scenario), stamp, self._frames))
        self._moved = stamp, listeners
        inertia = self._inertial_unit.measure(frame.car, stamp)  # of every state, or it would depend on who listens
        if self._imu.get_subscription_count():
            self._imu.publish(inertia_to_message(inertia, stamp, self._frames))
        self._publish_scan(frame, stamp)
        if self._detections is not None and self._detections.get_subscription_count():
            scenario = self._episode.scenario
            self._detections.publish(detections(scenario, frame.scene(scenario), stamp, self._frames.odom))
        if self._car.get_subscription_count():
            self._car.publish(car_to_odometry(frame.car, stamp, self._frames))
        if self._adversary.get_subscription_count():
            self._adversary.publish(adversary_to_odometry(frame.adversary, stamp))

    def _publish_scan(self, frame: Frame, stamp: int) -> None:
        if self._laser is None or (frame.tick * self._periods + frame.period) % self._scan_every:
            return
        wanted = self._scan.get_subscription_count(), self._points.get_subscription_count()
        if any(wanted):
            scan = self._laser.scan(frame.car, frame.adversary, frame.tick, frame.period)
            if wanted[0]:
                self._scan.publish(scan_to_message(scan, stamp, self._frames))
            if wanted[1]:
                self._points.publish(scan_to_points(scan, stamp, self._frames))


CAR_HEIGHT = 1.5
"""Of the body, m; it is looked at only."""
LASER_HEIGHT = 0.3
"""Of the scanner above the ground, m: the world is flat, but filters by height take what lies at 0 for the road."""

_LASER_RADIUS, _LASER_LENGTH = 0.05, 0.07  # m


def robot_description(scenario: Scenario, frames: Frames = FRAMES) -> str:
    """Return the URDF of a scenario's car, and of its laser where it has one.

    Args:
        scenario: gives footprint and sensor.
        frames: names of the links.
    """
    car, sensor = scenario.car, scenario.sensor
    robot = ElementTree.Element("robot", name="car_under_test")
    middle = (0.5 * (car.front - car.rear), 0.0, 0.5 * CAR_HEIGHT)
    size = _numbers((car.front + car.rear, car.width, CAR_HEIGHT))
    _link(robot, frames.base, middle, ("box", {"size": size}), "0.29 0.44 0.65 0.9")
    if sensor is not None:
        shape = {"radius": repr(_LASER_RADIUS), "length": repr(_LASER_LENGTH)}
        _link(robot, frames.laser, (0.0, 0.0, 0.0), ("cylinder", shape), "0.1 0.1 0.1 1.0")
        joint = ElementTree.SubElement(robot, "joint", name=f"{frames.laser}_mount", type="fixed")
        ElementTree.SubElement(joint, "parent", link=frames.base)
        ElementTree.SubElement(joint, "child", link=frames.laser)
        ElementTree.SubElement(joint, "origin", xyz=_numbers(laser_mount(scenario)), rpy="0 0 0")
    ElementTree.indent(robot)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(robot, encoding="unicode")}\n'


def laser_mount(scenario: Scenario) -> tuple[float, float, float]:
    """Return where the laser is in the frame of the car, m; it looks straight ahead.

    Raises:
        ValueError: the scenario has no sensor.
    """
    if scenario.sensor is None:
        raise ValueError(f"scenario {scenario.name} has no sensor")
    return scenario.sensor.mount_ahead, 0.0, LASER_HEIGHT


def _link(
    robot: ElementTree.Element,
    name: str,
    middle: tuple[float, float, float],
    shape: tuple[str, dict[str, str]],
    colour: str,
) -> None:
    link = ElementTree.SubElement(robot, "link", name=name)
    for part in ("visual", "collision"):
        element = ElementTree.SubElement(link, part)
        ElementTree.SubElement(element, "origin", xyz=_numbers(middle), rpy="0 0 0")
        ElementTree.SubElement(ElementTree.SubElement(element, "geometry"), shape[0], shape[1])
        if part == "visual":
            material = ElementTree.SubElement(element, "material", name=f"{name}_colour")
            ElementTree.SubElement(material, "color", rgba=colour)


def _numbers(values: tuple[float, float, float]) -> str:
    return " ".join(repr(float(value)) for value in values)


try:
    from vision_msgs.msg import Detection3D, Detection3DArray, ObjectHypothesisWithPose
except ImportError:  # ROS 2's base installation lacks it
    Detection3DArray = None

DETECTIONS: type | None = Detection3DArray
"""Type of the messages; none where the package is missing."""
TRACK = "adversary"
"""The adversary's id in every message; that of `others[0]` is `other_0`."""


def detections(scenario: Scenario, scene: Scene, stamp: int, frame_id: str) -> Any:
    """Return a Detection3DArray with the adversary and the others; velocities have no place in that message.

    Args:
        scenario: gives kinds, which are the classes, and shapes; the box of a disc is as wide as the disc.
        scene: true states.
        stamp: time stamp, ns.
        frame_id: frame in which the states are.
    """
    found = [_detection(TRACK, scenario.adversary, scene.adversary)]
    for index, (other, state) in enumerate(zip(scenario.others, scene.others, strict=True)):
        found.append(_detection(f"other_{index}", other, state))
    message = Detection3DArray(detections=found)
    for one in (message, *found):
        one.header.stamp, one.header.frame_id = to_stamp(stamp), frame_id
    return message


def _detection(track: str, body: Body, state: RoadUserState) -> Any:
    detection, result = Detection3D(id=track), ObjectHypothesisWithPose()
    result.hypothesis.class_id, result.hypothesis.score = body.kind, 1.0
    height = height_of(body.kind)
    box, size = detection.bbox.center, detection.bbox.size
    box.position.x, box.position.y, box.position.z = state.x, state.y, 0.5 * height
    box.orientation = to_orientation(state.heading)
    radius, half_length, half_width = body.shape
    size.x, size.y, size.z = 2.0 * (radius or half_length), 2.0 * (radius or half_width), height
    result.pose.pose, result.pose.covariance = box, COVARIANCE_6
    detection.results = [result]
    return detection


INITIAL_POSE = "initialpose"
_X, _Y, _YAW = 0, 7, 35  # on the diagonal of a covariance of 6 × 6, row by row
_VARIANCE = 1e-6  # m² and rad²: it is exact, and zero would say that it is not known


class InitialPose:
    """Publishes where the car starts; a node that subscribes while an episode runs gets it, too."""

    def __init__(self, node: Node) -> None:
        """Make the topic."""
        self._publisher = node.create_publisher(PoseWithCovarianceStamped, INITIAL_POSE, LATCHED)

    def publish(self, car: CarState, stamp: int) -> None:
        """Publish the pose with a stamp (ns)."""
        message = PoseWithCovarianceStamped()
        message.header.stamp = to_stamp(stamp)
        message.header.frame_id = MAP_FRAME
        pose = message.pose.pose
        pose.position.x, pose.position.y = car.x, car.y
        pose.orientation.z, pose.orientation.w = math.sin(0.5 * car.heading), math.cos(0.5 * car.heading)
        for place in (_X, _Y, _YAW):
            message.pose.covariance[place] = _VARIANCE
        self._publisher.publish(message)
