"""What a stack hears: clock, transforms, odometries, measurements of the car's sensors, and the car's shape.

Each goes out only while somebody listens.
"""

from __future__ import annotations

from typing import Any

from nav_msgs.msg import Odometry
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, LaserScan, PointCloud2
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from skd_sim.options.frames import Frames
from skd_sim.options.graph_options import StateOptions
from skd_sim.ros.robot_description import laser_mount, robot_description
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
    adversary_to_odometry,
    car_to_odometry,
    car_to_transform,
    inertia_to_message,
    scan_to_message,
    scan_to_points,
    static_transforms,
    to_stamp,
)
from skd_sim.ros.tracked_objects import DETECTIONS, detections
from skd_sim.world.episode import Episode
from skd_sim.world.sensors import InertialUnit, PlanarLaser, make_laser
from skd_sim.world.simulator import Frame


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

    def begin(self, episode: Episode, stamp: int) -> None:
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
            self._transform.publish(car_to_transform(frame.car, stamp, self._frames))
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
