"""Between CARLA's ROS bridge and the crossing: states in, controls out. Nothing here needs CARLA or ROS.

carla_ros_bridge publishes `nav_msgs/Odometry` in its map, right-handed with z up, and the twist in the actor's axes.
Messages are read by their fields only.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from skd_sim.world.heading import on_grid
from skd_sim.world.placement import Placement
from skd_sim.world.state import AdversaryState, CarState


class Pedals(NamedTuple):
    """Positions of the pedals, each in [0, 1]; at most one of them is above 0."""

    throttle: float
    brake: float


class WalkerControl(NamedTuple):
    """Where an adversary on foot goes: unit direction in the map and speed, m/s."""

    x: float
    y: float
    speed: float


def yaw_of(orientation: Any) -> float:
    """Return the rotation about z (rad) of a quaternion, whatever pitch and roll it has."""
    x, y, z, w = (float(getattr(orientation, name)) for name in "xyzw")
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def car_from_odometry(message: Any, placement: Placement) -> CarState:
    """Return the car's state in the crossing's frame; a car that rolls back has speed 0."""
    position = message.pose.pose.position
    speed = max(0.0, float(message.twist.twist.linear.x))
    car = CarState(float(position.x), float(position.y), yaw_of(message.pose.pose.orientation), speed)
    return placement.car_to_crossing(car)


def adversary_from_odometry(message: Any, placement: Placement) -> AdversaryState:
    """Return the adversary's state in the crossing's frame; its twist comes in its own axes, ours is in the frame's."""
    position, linear = message.pose.pose.position, message.twist.twist.linear
    facing = Placement(0.0, 0.0, yaw_of(message.pose.pose.orientation))
    vx, vy = facing.vector_to_map(float(linear.x), float(linear.y))
    return placement.adversary_to_crossing(AdversaryState(float(position.x), float(position.y), vx, vy))


def box_from_odometry(message: Any, placement: Placement, velocity: tuple[float, float]) -> AdversaryState:
    """Return the state of an adversary that is put where it is to be, in the crossing's frame.

    Args:
        message: its odometry; what is put there has a place and a heading, and no velocity of its own.
        placement: where the crossing lies.
        velocity: velocity with which it is put on, (East, North) in the crossing's frame, m/s.
    """
    position = message.pose.pose.position
    place = placement.point_to_crossing(float(position.x), float(position.y))
    heading = math.remainder(yaw_of(message.pose.pose.orientation) - placement.yaw, math.tau)
    return AdversaryState(*place, *velocity, float(on_grid(heading)))


def pedals(acceleration: float, full_throttle: float, full_brake: float) -> Pedals:
    """Return the pedals for an acceleration command (m/s²), linear up to what a full pedal gives.

    Args:
        acceleration: commanded acceleration of the car, m/s².
        full_throttle: acceleration at full throttle, m/s², > 0.
        full_brake: deceleration at full brake, m/s², > 0.
    """
    return Pedals(
        min(1.0, max(0.0, acceleration / full_throttle)),
        min(1.0, max(0.0, -acceleration / full_brake)),
    )


def walker_control(velocity: tuple[float, float], placement: Placement) -> WalkerControl:
    """Return the control of an adversary on foot for a velocity (m/s) in the crossing's frame."""
    speed = math.hypot(*velocity)
    if speed == 0.0:
        return WalkerControl(*placement.vector_to_map(1.0, 0.0), 0.0)
    return WalkerControl(*placement.vector_to_map(velocity[0] / speed, velocity[1] / speed), speed)
