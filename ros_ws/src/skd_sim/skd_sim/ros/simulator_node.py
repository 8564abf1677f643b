"""Node `vehicle_simulator`, and the part of a simulator in the graph: states go out, commands come in.

A stack hears clock, transforms, odometries, measurements of the car's sensors, start pose and shape. Each goes out only
while a node listens. Adversary and others are tracked objects of vision_msgs, where that package is installed. The
car's shape is a URDF: its body is the footprint of the scenario's car, as high as it is drawn. There are no movable
joints, since nothing is known of the wheels; so no `/joint_states` are needed either.

The rules of an episode are `skd_sim.ros.lockstep`, the motion is the simulator's. Here are topics, parameters and
timers. `lockstep`: publishes the state of tick k and advances when both commands stamped t_k have arrived. `real_time`:
ticks on its own and holds the last commands. A command source that stays silent ends the episode as ABORTED, by name.
"""

from __future__ import annotations

import math
import time
from array import array
from collections.abc import Callable, Mapping, Sequence
from typing import Any
from xml.sax.saxutils import quoteattr

import rclpy.clock
from geometry_msgs.msg import AccelStamped, PoseWithCovarianceStamped, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, LaserScan, PointCloud2
from skd_msgs.msg import Episode as EpisodeMsg
from skd_msgs.msg import EpisodeResult
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from skd_sim.errors import UsageError
from skd_sim.options.options import (
    ADVERSARY_FRAME,
    FRAMES,
    MAP_FRAME,
    REAL_TIME,
    CommandOptions,
    Frames,
    SimulatorOptions,
    StateOptions,
    values_of,
)
from skd_sim.ros import lockstep, to_messages
from skd_sim.ros.commands import Quantity, angle_of_yaw_rate, car_commands, follow_speed
from skd_sim.ros.diagnosis import Awaited, Evidence, diagnose, kind_name, second_publisher
from skd_sim.ros.from_messages import from_stamp, message_to_episode
from skd_sim.ros.support import LATCHED, STREAM, GraphNode, Topic, declare, run_node
from skd_sim.scenario.road_user import Body, height_of
from skd_sim.scenario.scenario import Scenario
from skd_sim.simulators.simulator import Frame, NamedSimulator, Simulator, SimulatorError, require_others
from skd_sim.world.dynamics.basic import Command, CommandLimits, wheels
from skd_sim.world.episode import AbortKind, EpisodeSpec, Outcome, Schedule, abort_reason
from skd_sim.world.sensors import InertialUnit, PlanarLaser, make_laser
from skd_sim.world.state import AdversaryState, CarState, Pair, RoadUserState, Scene

TABLES = (SimulatorOptions,)
"""Of every simulator's parameters."""

_WATCH_PERIOD = 0.05  # s of wall time
_NOWHERE = Frame(0, CarState(0.0, 0.0, 0.0, 0.0), AdversaryState(0.0, 0.0, 0.0, 0.0))  # of an episode that is refused


# --- what a stack hears


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


# --- the simulator's part


class _Publishers(lockstep.Senders):
    """Which nodes publish on a topic of commands, as the middleware sees it."""

    def __init__(self, node: Node, subscription: Any, *, by_stamp: bool = True) -> None:
        self._node, self._subscription, self._by_stamp = node, subscription, by_stamp

    def count(self) -> int:
        return int(self._subscription.get_publisher_count())

    def crowd(self) -> str | None:
        return second_publisher(self._node, self._subscription.topic_name)

    def diagnosis(self) -> str:
        awaited = Awaited(self._subscription.topic_name, kind_name(self._subscription.msg_type))
        return diagnose(Evidence(self._node, awaited, by_stamp=self._by_stamp)).text


class GraphSimulator:
    """Ground truth of the graph; one episode at a time.

    It speaks through a node that may belong to others as well. Objects of the same process hear states and results by
    a call, and call `begin` and `walk`; others use the topics.

    Attributes:
        on_frame: called with each state and its stamp (ns).
        on_result: called with the result of an episode, a skd_msgs/EpisodeResult.
    """

    def __init__(
        self, node: Node, simulator: Simulator, values: Mapping[str, Any], *, clock: bool = True, alone: bool = True
    ) -> None:
        """Make the topics; then wait for an episode.

        Args:
            node: node that speaks and listens.
            simulator: simulator that moves car and adversary.
            values: values of `TABLES` by name.
            clock: whether it publishes `/clock`; a simulator may do so itself.
            alone: whether evaluator and adversary are in other processes.
        """
        self._node, self._simulator, self._values = node, simulator, values
        self.on_frame: Callable[[int, Frame], None] = lambda _stamp, _frame: None
        self.on_result: Callable[[EpisodeResult], None] = lambda _result: None
        self._states = StatePublisher(
            node, StateOptions(**values_of(StateOptions, values)), clock=clock, initial_pose=values["initial_pose"]
        )
        self._result = node.create_publisher(EpisodeResult, Topic.EPISODE_RESULT, STREAM)
        self._applied = node.create_publisher(AccelStamped, Topic.COMMAND, STREAM)
        self._lockstep = self._listen_to_commands(alone=alone)
        if alone:
            node.create_subscription(EpisodeMsg, Topic.EPISODE, self.begin, LATCHED)
        self._steady = rclpy.clock.Clock(clock_type=rclpy.clock.ClockType.STEADY_TIME)
        self._watch = node.create_timer(
            _WATCH_PERIOD, lambda: self._do(self._lockstep.watch(time.monotonic())), clock=self._steady
        )
        self._ticker: Any = None
        self._schedule: Schedule | None = None
        self._quiet: Any = None
        if values["quiet_time"]:
            self._quiet = node.create_timer(values["quiet_time"], self._on_quiet, clock=self._steady)
            self._quiet.cancel()
        self._message: Any = None

    def _listen_to_commands(self, *, alone: bool) -> lockstep.Lockstep:
        values, node = self._values, self._node
        commands = car_commands(CommandOptions(**values_of(CommandOptions, values)))
        topic = values["command_topic"]

        def on_command(message: Any) -> None:
            try:
                stamp, command = commands.read(message)
            except IndexError as error:
                said = f"a message on {topic} is left out: {commands.format.field}: {error}"
                node.get_logger().warning(said, throttle_duration_sec=5.0)
                return
            self._do(self._lockstep.drive(stamp, *command, now=time.monotonic()))

        def on_velocity(message: TwistStamped) -> None:
            linear = message.twist.linear
            self.walk(from_stamp(message.header.stamp), (linear.x, linear.y))

        real_time = values["pacing"] == REAL_TIME
        by_stamp = not (real_time or values["quiet_time"])
        heard = node.create_subscription(commands.kind, topic, on_command, STREAM)
        drives = _Publishers(node, heard, by_stamp=by_stamp)
        walks = lockstep.Senders()
        if alone:
            walks = _Publishers(
                node, node.create_subscription(TwistStamped, Topic.VELOCITY_COMMAND, on_velocity, STREAM)
            )
        low, high = -values["maximum_deceleration"], values["maximum_acceleration"]
        self._follows = None if commands.format.quantity == Quantity.ACCELERATION else CommandLimits(low, high)
        self._yaw_rate = commands.format.is_yaw_rate
        if real_time and values["quiet_time"]:
            raise UsageError("quiet_time goes with --pacing lockstep: real time does not wait")
        return lockstep.Lockstep(
            lockstep.CommandSource("the car controller", topic, drives),
            lockstep.CommandSource("the adversary", Topic.VELOCITY_COMMAND, walks),
            lockstep.WaitLimits(values["command_timeout"], values["startup_timeout"]),
            real_time=real_time,
            quiet_time=values["quiet_time"],
        )

    # --- episodes

    def begin(self, message: EpisodeMsg) -> None:
        """Begin an episode, unless it has begun."""
        if self._message is not None and _identity(self._message) == _identity(message):
            return
        self._stop()
        self._message = message
        self._start = from_stamp(message.header.stamp)
        self._schedule = None
        self._commands: list[Pair] = []
        try:
            self._episode: EpisodeSpec = message_to_episode(message)
            require_others(self._simulator, self._node.get_name(), self._episode)
            self._frame = self._simulator.reset(self._episode)
        except ValueError as error:
            self._refuse(abort_reason(AbortKind.FAILED, f"{self._node.get_name()}: {error}"))
            return
        except SimulatorError as fault:
            self._refuse(str(fault))
            return
        self._states.begin(self._episode, self._frame.car, self._start)
        begun = self._lockstep.begin(self._start, self._episode.scenario, self._frame, time.monotonic())
        self._publish_state()
        self._do(begun)

    def _refuse(self, reason: str) -> None:
        self._publish_result(lockstep.End(Outcome.ABORTED, _NOWHERE, self._start, reason), 0)

    def _stop(self) -> None:
        self._lockstep.stop()
        if self._ticker is not None:
            self._node.destroy_timer(self._ticker)
            self._ticker = None
        if self._quiet is not None:
            self._quiet.cancel()

    # --- what arrives

    def walk(self, stamp: int, velocity: Pair) -> None:
        """Take the adversary's velocity, (East, North), m/s, for the tick of a stamp (ns)."""
        self._do(self._lockstep.walk(stamp, velocity, now=time.monotonic()))

    def _on_ticker(self) -> None:
        now = time.monotonic()
        assert self._schedule is not None
        late, limit = self._schedule.late(now), max(self._values["slip_limit"], 0.5 * self._schedule.period)
        if late <= limit:
            self._do(self._lockstep.go_on(now))
            return
        slipped = f"{self._node.get_name()} came {late:.3f} s late to tick {self._frame.tick} (slip_limit {limit:g} s)"
        self._do(self._lockstep.fail(abort_reason(AbortKind.SLIPPED, slipped)))

    def _on_quiet(self) -> None:
        self._quiet.cancel()
        self._do(self._lockstep.quiet(time.monotonic()))

    # --- what comes of it

    def _do(self, action: lockstep.Action | None) -> None:
        if isinstance(action, lockstep.ControlStep):
            self._step(action)
        elif isinstance(action, lockstep.Start):
            period = self._episode.scenario.control_duration / self._values["rate_factor"]
            self._schedule = Schedule(time.monotonic(), period)
            self._ticker = self._node.create_timer(period, self._on_ticker, clock=self._steady)
        elif isinstance(action, lockstep.Repeat):
            self._publish_state()
        elif isinstance(action, lockstep.End):
            self._publish_result(action, self._simulator.clipped)
            self._stop()

    def _step(self, commands: lockstep.ControlStep) -> None:
        acceleration, steering, car = commands.drive, commands.steering, self._frame.car
        if self._yaw_rate:
            steering = angle_of_yaw_rate(steering, car.speed, wheels(self._episode.scenario.car)[0])
        if self._follows is not None:
            duration = self._episode.scenario.control_duration
            acceleration = follow_speed(commands.drive, car.speed, duration, self._follows, commands.limit)
        if self._applied.get_subscription_count():
            stamp = lockstep.frame_stamp(self._start, self._frame, self._episode.scenario)
            self._applied.publish(to_messages.acceleration_command((acceleration, steering), stamp))
        self._commands.append((acceleration, steering))
        try:  # a simulator that does not steer takes a float
            command: Command = (acceleration, steering) if steering else acceleration
            self._frame = self._simulator.step(command, commands.velocity)
        except (SimulatorError, UsageError) as fault:
            self._do(self._lockstep.fail(_reason(fault)))
            return
        end = self._lockstep.advance(self._frame, time.monotonic())
        self._publish_state()
        self._do(end)

    def _publish_state(self) -> None:
        stamp = lockstep.frame_stamp(self._start, self._frame, self._episode.scenario)
        if self._quiet is None:
            self._states.tell_time(stamp - self._lockstep.lead)
            self._states.publish(self._frame, stamp)
        else:  # who decides by the clock is to know the state by then
            self._states.publish(self._frame, stamp)
            self._states.tell_time(stamp - self._lockstep.lead)
            self._quiet.reset()
        self.on_frame(stamp, self._frame)

    # --- results

    def _publish_result(self, end: lockstep.End, clipped: int) -> None:
        result = EpisodeResult(outcome=int(end.outcome), ticks=end.frame.tick, reason=end.reason)
        result.header = to_messages.header(end.stamp, MAP_FRAME)
        result.campaign = self._message.campaign
        result.episode_id = int(self._message.episode_id)
        result.start = to_messages.to_stamp(self._start)
        result.commands_clipped = clipped
        result.commands = [to_messages.acceleration_command(one, 0).accel for one in self._commands]
        result.command_ages = array("f", self._lockstep.ages.ages)
        result.commands_held = self._lockstep.ages.held
        result.greatest_delay = 0.0 if self._schedule is None else self._schedule.worst
        result.impact_time, result.impact_speed = math.nan, math.nan
        if end.outcome == Outcome.COLLISION:
            result.impact_time, result.impact_speed = end.frame.impact(self._episode.scenario.time_step)
        if self._result.get_subscription_count():
            self._result.publish(result)
        self.on_result(result)


def _reason(fault: Exception) -> str:
    return str(fault) if isinstance(fault, SimulatorError) else abort_reason(AbortKind.FAILED, str(fault))


def _identity(message: Any) -> tuple[str, int, int]:
    return str(message.campaign), int(message.episode_id), from_stamp(message.header.stamp)


class VehicleSimulator(GraphNode):
    """The world, and its clock."""

    def __init__(self, **node_arguments: Any) -> None:
        """Declare parameters, with arguments of `rclpy.node.Node`; then wait for an episode."""
        super().__init__("vehicle_simulator", **node_arguments)
        self.simulator = GraphSimulator(self, NamedSimulator(), declare(self, *TABLES))


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run_node(VehicleSimulator, args)


if __name__ == "__main__":
    raise SystemExit(main())
