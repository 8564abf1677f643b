"""From the library's own types to messages; every float passes through unchanged, bit for bit."""

from __future__ import annotations

import json
import math
from array import array

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import AccelStamped, Point, TwistStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import LaserScan
from skd_msgs.msg import Episode as EpisodeMsg

from skd_sim.episode import Episode
from skd_sim.options import options_of, options_to_text
from skd_sim.sensors import Scan
from skd_sim.stamps import NANOSECONDS
from skd_sim.state import CarState, PedestrianState

MAP_FRAME = "map"
CAR_FRAME = "ego/base_link"
LASER_FRAME = "ego/laser"
PEDESTRIAN_FRAME = "pedestrian"


def to_stamp(nanoseconds: int) -> Time:
    """Return a time message."""
    seconds, rest = divmod(nanoseconds, NANOSECONDS)
    return Time(sec=seconds, nanosec=rest)


def car_to_odometry(car: CarState, stamp: int) -> Odometry:
    """Return the car's odometry: pose of the reference point in `map`, speed along the car's own x axis."""
    message = Odometry()
    message.header.stamp = to_stamp(stamp)
    message.header.frame_id = MAP_FRAME
    message.child_frame_id = CAR_FRAME
    message.pose.pose.position.x = car.x
    message.pose.pose.position.y = car.y
    message.pose.pose.orientation.z = math.sin(0.5 * car.heading)
    message.pose.pose.orientation.w = math.cos(0.5 * car.heading)
    message.twist.twist.linear.x = car.speed
    return message


def pedestrian_to_odometry(pedestrian: PedestrianState, stamp: int) -> Odometry:
    """Return the adversary's odometry; the twist is along the axes of `map`, whichever way a box points."""
    message = Odometry()
    message.header.stamp = to_stamp(stamp)
    message.header.frame_id = MAP_FRAME
    message.child_frame_id = PEDESTRIAN_FRAME
    message.pose.pose.position.x = pedestrian.x
    message.pose.pose.position.y = pedestrian.y
    message.pose.pose.orientation.z = math.sin(0.5 * pedestrian.heading)
    message.pose.pose.orientation.w = math.cos(0.5 * pedestrian.heading)
    message.twist.twist.linear.x = pedestrian.vx
    message.twist.twist.linear.y = pedestrian.vy
    return message


def scan_to_message(scan: Scan, stamp: int) -> LaserScan:
    """Return a scan in the frame of the sensor: all beams at once, at `stamp` (ns)."""
    message = LaserScan()
    message.header.stamp = to_stamp(stamp)
    message.header.frame_id = LASER_FRAME
    message.angle_min = scan.angle_min
    message.angle_max = scan.angle_min + (len(scan.ranges) - 1) * scan.angle_increment
    message.angle_increment = scan.angle_increment
    message.range_max = scan.range_max
    message.ranges = array("f", scan.ranges.astype(np.float32, copy=False).tobytes())  # faster than a list
    return message


def acceleration_command(acceleration: float, stamp: int) -> AccelStamped:
    """Return the car's command for the tick with this stamp (ns), m/s²."""
    message = AccelStamped()
    message.header.stamp = to_stamp(stamp)
    message.header.frame_id = CAR_FRAME
    message.accel.linear.x = float(acceleration)
    return message


def velocity_command(velocity: tuple[float, float], stamp: int) -> TwistStamped:
    """Return the pedestrian's command for the tick with this stamp (ns): (East, North), m/s."""
    message = TwistStamped()
    message.header.stamp = to_stamp(stamp)
    message.header.frame_id = MAP_FRAME
    message.twist.linear.x = float(velocity[0])
    message.twist.linear.y = float(velocity[1])
    return message


def episode_to_message(episode: Episode, campaign: str, start: int) -> EpisodeMsg:
    """Return the message of an episode that starts at `start` (ns)."""
    message = EpisodeMsg()
    message.header.stamp = to_stamp(start)
    message.header.frame_id = MAP_FRAME
    message.campaign = campaign
    message.episode_id = episode.episode_id
    message.seed = episode.seed
    message.mode = int(episode.mode)
    message.scenario = json.dumps(episode.scenario.as_dict())
    for one in options_of(Episode):
        if one.field:
            setattr(message, one.name, one.plain(getattr(episode, one.name)))
    message.options = options_to_text(episode)
    if episode.safe_trajectory is not None:
        message.safe_trajectory_name = episode.safe_trajectory.name
        message.safe_trajectory_time_step = float(episode.safe_trajectory.time_step)
        points = episode.safe_trajectory.positions.tolist()
        message.safe_trajectory = [Point(x=x, y=y, z=0.0) for x, y in points]
    return message
