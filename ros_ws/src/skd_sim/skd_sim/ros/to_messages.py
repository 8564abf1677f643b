"""From the library's own types to messages; every float passes through unchanged, bit for bit."""

from __future__ import annotations

import functools
import json
import math
from array import array

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import AccelStamped, Point, Quaternion, TransformStamped, TwistStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu, LaserScan, PointCloud2, PointField
from skd_msgs.msg import Episode as EpisodeMsg
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from skd_sim.options.options import ADVERSARY_FRAME, FIELDS, FRAMES, MAP_FRAME, Frames, options_of, options_to_text
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.dynamics.basic import Command, as_pair
from skd_sim.world.episode import NANOSECONDS, EpisodeSpec, controller_seed
from skd_sim.world.sensors import Inertia, Scan
from skd_sim.world.state import AdversaryState, CarState, Pair, Scene, Triple, to_body

_VARIANCE = 1e-6  # of each number, in SI units squared. All are true; but filters invert covariances, and zeros have no
# inverse, and to a sensor_msgs/Imu they say that nothing is known of it.
COVARIANCE_6 = [_VARIANCE if row == column else 0.0 for row in range(6) for column in range(6)]
"""Of a pose or a twist that is the truth."""
_COVARIANCE_3 = [_VARIANCE if row == column else 0.0 for row in range(3) for column in range(3)]


def to_stamp(nanoseconds: int) -> Time:
    """Return a time message."""
    seconds, rest = divmod(nanoseconds, NANOSECONDS)
    return Time(sec=seconds, nanosec=rest)


def header(stamp: int, frame: str) -> Header:
    """Return a header with a stamp, ns."""
    return Header(stamp=to_stamp(stamp), frame_id=frame)


def to_orientation(heading: float) -> Quaternion:
    """Return a heading (rad) as a quaternion."""
    return Quaternion(z=math.sin(0.5 * heading), w=math.cos(0.5 * heading))


@functools.cache
def _odometry(frame: str, child: str) -> Odometry:
    """Return the one message that is filled again for each state: to make another one takes longer than to publish."""
    message = Odometry(child_frame_id=child)
    message.header.frame_id = frame
    message.pose.covariance = message.twist.covariance = COVARIANCE_6
    return message


def car_to_odometry(car: CarState, stamp: int, frames: Frames = FRAMES) -> Odometry:
    """Return the car's odometry: pose of the reference point in `odom`, speed along the car's own x axis.

    The message is the same object in each call, for publishing at once.
    """
    message = _odometry(frames.odom, frames.base)
    message.header.stamp = to_stamp(stamp)
    message.pose.pose.position.x = car.x
    message.pose.pose.position.y = car.y
    message.pose.pose.orientation = to_orientation(car.heading)
    message.twist.twist.linear.x = car.speed
    return message


def adversary_to_odometry(adversary: AdversaryState, stamp: int) -> Odometry:
    """Return the adversary's odometry, as `car_to_odometry`; the twist is along its own axes."""
    message = _odometry(MAP_FRAME, ADVERSARY_FRAME)
    linear = message.twist.twist.linear
    message.header.stamp = to_stamp(stamp)
    message.pose.pose.position.x = adversary.x
    message.pose.pose.position.y = adversary.y
    message.pose.pose.orientation = to_orientation(adversary.heading)
    linear.x, linear.y = to_body(adversary.vx, adversary.vy, adversary.heading)
    return message


def scene_to_transforms(scene: Scene, stamp: int, frames: Frames = FRAMES) -> TFMessage:
    """Return the transforms `odom` → `base_link`, `map` → `adversary`, and `map` → `other_0` and so on."""
    car, users = scene.ego, {ADVERSARY_FRAME: scene.adversary}
    users |= {f"other_{number}": state for number, state in enumerate(scene.others)}
    moved = [_transform(frames.odom, frames.base, (car.x, car.y, 0.0), stamp, car.heading)]
    moved += [_transform(MAP_FRAME, name, (one.x, one.y, 0.0), stamp, one.heading) for name, one in users.items()]
    return TFMessage(transforms=moved)


def static_transforms(mount: Triple | None, stamp: int, frames: Frames = FRAMES, *, with_map: bool = True) -> TFMessage:
    """Return the transforms that do not change: `map` → `odom`, the identity, and `base_link` → `laser`.

    Args:
        mount: place of the laser in the frame of the car, m; None where there is no laser.
        stamp: time stamp, ns.
        frames: names of the frames.
        with_map: whether `map` → `odom` is among them.
    """
    message = TFMessage()
    if with_map:
        message.transforms.append(_transform(MAP_FRAME, frames.odom, (0.0, 0.0, 0.0), stamp))
    if mount is not None:
        message.transforms.append(_transform(frames.base, frames.laser, mount, stamp))
    return message


def _transform(parent: str, child: str, place: Triple, stamp: int, heading: float = 0.0) -> TransformStamped:
    transform = TransformStamped(header=header(stamp, parent), child_frame_id=child)
    translation = transform.transform.translation
    translation.x, translation.y, translation.z = place
    transform.transform.rotation = to_orientation(heading)
    return transform


def inertia_to_message(inertia: Inertia, stamp: int, frames: Frames = FRAMES) -> Imu:
    """Return what the inertial unit measures, in the frame of the car (REP 145)."""
    message = Imu(header=header(stamp, frames.base), orientation=to_orientation(inertia.heading))
    message.angular_velocity.z = inertia.yaw_rate
    acceleration = message.linear_acceleration
    acceleration.x, acceleration.y, acceleration.z = inertia.acceleration
    message.orientation_covariance = message.angular_velocity_covariance = _COVARIANCE_3
    message.linear_acceleration_covariance = _COVARIANCE_3
    return message


def scan_to_message(scan: Scan, stamp: int, frames: Frames = FRAMES) -> LaserScan:
    """Return a scan in the frame of the sensor: all beams at once, at `stamp` (ns)."""
    message = LaserScan(header=header(stamp, frames.laser))
    message.angle_min = scan.angle_min
    message.angle_max = scan.angle_min + (len(scan.ranges) - 1) * scan.angle_increment
    message.angle_increment = scan.angle_increment
    message.range_max = scan.range_max
    message.ranges = array("f", scan.ranges.astype(np.float32, copy=False).tobytes())  # faster than a list
    return message


def scan_to_points(scan: Scan, stamp: int, frames: Frames = FRAMES) -> PointCloud2:
    """Return what came back of a scan as a point cloud in the frame of the sensor: x, y, z, single precision."""
    points = scan.points()
    message = PointCloud2(header=header(stamp, frames.laser))
    message.fields = [
        PointField(name=name, offset=4 * place, datatype=PointField.FLOAT32, count=1)
        for place, name in enumerate(("x", "y", "z"))
    ]
    message.height, message.width = 1, len(points)
    message.point_step, message.row_step = 12, 12 * len(points)
    message.is_dense = True
    message.data = array("B", points.astype("<f4", copy=False).tobytes())
    return message


def acceleration_command(command: Command, stamp: int) -> AccelStamped:
    """Return the car's command for the tick with this stamp (ns): m/s², and as `accel.angular.z` what it steers by."""
    message = AccelStamped(header=header(stamp, FRAMES.base))
    message.accel.linear.x, message.accel.angular.z = as_pair(command)
    return message


def velocity_command(velocity: Pair, stamp: int) -> TwistStamped:
    """Return the adversary's command for the tick with this stamp (ns): (East, North), m/s."""
    message = TwistStamped(header=header(stamp, MAP_FRAME))
    message.twist.linear.x = float(velocity[0])
    message.twist.linear.y = float(velocity[1])
    return message


@functools.lru_cache(maxsize=64)
def scenario_text(scenario: Scenario) -> str:
    """Return a scenario as text; a campaign has the same one over and over."""
    return json.dumps(scenario.as_dict())


def episode_to_message(episode: EpisodeSpec, campaign: str, start: int) -> EpisodeMsg:
    """Return the message of an episode that starts at `start` (ns)."""
    message = EpisodeMsg(
        header=header(start, MAP_FRAME),
        campaign=campaign,
        episode_id=episode.episode_id,
        seed=episode.seed,
        mode=int(episode.mode),
        controller_seed=np.frombuffer(controller_seed(episode.seed, episode.episode_id), np.uint8),
        scenario=scenario_text(episode.scenario),
        public_scenario="" if episode.public is None else scenario_text(episode.public),
        options=options_to_text(episode),
        **{one.name: one.plain(getattr(episode, one.name)) for one in options_of(EpisodeSpec) if one.name in FIELDS},
    )
    if episode.safe_trajectory is not None:
        message.safe_trajectory_name = episode.safe_trajectory.name
        message.safe_trajectory_time_step = float(episode.safe_trajectory.time_step)
        points = episode.safe_trajectory.positions.tolist()
        message.safe_trajectory = [Point(x=x, y=y, z=0.0) for x, y in points]
    return message
