"""From messages to the library's own types; every float passes through unchanged, bit for bit.

Messages are read by their fields only. So messages of rclpy and of a bag reader both work, and nothing of ROS is
imported.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np

from skd_sim.inputs.files import parse_json
from skd_sim.options.options import FIELDS, options_from_text, options_of
from skd_sim.scenario.scenario import Scenario, scenario_from_dict
from skd_sim.world.episode import NANOSECONDS, EpisodeSpec, Mode, controller_generator
from skd_sim.world.sensors import Scan
from skd_sim.world.state import AdversaryState, CarState, Trajectory, heading_of, to_map


def from_stamp(stamp: Any) -> int:
    """Return a time message's nanoseconds."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def odometry_to_car(message: Any) -> CarState:
    """Return the car's state from its odometry (planar)."""
    pose = message.pose.pose
    heading = heading_of(pose.orientation.z, pose.orientation.w)
    return CarState(float(pose.position.x), float(pose.position.y), heading, float(message.twist.twist.linear.x))


def odometry_to_adversary(message: Any) -> AdversaryState:
    """Return the adversary's state from its odometry."""
    pose, linear = message.pose.pose, message.twist.twist.linear
    heading = heading_of(pose.orientation.z, pose.orientation.w)
    velocity = to_map(float(linear.x), float(linear.y), heading)
    return AdversaryState(float(pose.position.x), float(pose.position.y), *velocity, heading)


def message_to_scan(message: Any) -> Scan:
    """Return the scan in a LaserScan message."""
    ranges = np.asarray(message.ranges, dtype=np.float32)
    return Scan(ranges, float(message.angle_min), float(message.angle_increment), float(message.range_max))


@functools.lru_cache(maxsize=64)
def _scenario(text: str) -> Scenario:
    """Return the scenario in an episode's specification; a campaign has the same one over and over."""
    where = "scenario in /skd/episode"
    return scenario_from_dict(parse_json(text, where), where)


class CarEpisode(NamedTuple):
    """What the car under test may know of an episode.

    Attributes:
        scenario: where it drives.
        controller: its name.
        multiplier: C, where it has one.
        rng: what it may draw from.
    """

    scenario: Scenario
    controller: str
    multiplier: float
    rng: np.random.Generator


def message_to_car_episode(message: Any) -> CarEpisode:
    """Return what a message tells the car.

    Raises:
        UsageError: its scenario is not valid.
    """
    rng = controller_generator(bytes(message.controller_seed))
    public = str(message.public_scenario or message.scenario)
    return CarEpisode(_scenario(public), str(message.controller), float(message.multiplier), rng)


def message_to_episode(message: Any) -> EpisodeSpec:
    """Return the episode that a message specifies.

    Raises:
        UsageError: its scenario is not valid.
        ValueError: another field is not.
    """
    trajectory = None
    if len(message.safe_trajectory) > 0:
        points = np.array([(point.x, point.y) for point in message.safe_trajectory])
        trajectory = Trajectory(points, float(message.safe_trajectory_time_step), str(message.safe_trajectory_name))
    public = str(message.public_scenario)
    return EpisodeSpec(
        scenario=_scenario(str(message.scenario)),
        public=_scenario(public) if public else None,
        mode=Mode(int(message.mode)),
        seed=int(message.seed),
        episode_id=int(message.episode_id),
        safe_trajectory=trajectory,
        **{one.name: one.value(getattr(message, one.name)) for one in options_of(EpisodeSpec) if one.name in FIELDS},
        **options_from_text(str(message.options), "options in /skd/episode"),
    )
