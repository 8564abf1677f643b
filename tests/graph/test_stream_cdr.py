"""States and commands as bytes, against rclpy's own serialisation: what it writes is read, and the other way round."""

from __future__ import annotations

import math
import struct
from typing import Any

import pytest
from geometry_msgs.msg import AccelStamped, TwistStamped
from hypothesis import given
from hypothesis import strategies as st
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from skd_sim.choices.frames import Frames
from skd_sim.messages.from_messages import from_stamp, odometry_to_adversary, odometry_to_car
from skd_sim.messages.stream_cdr import (
    CdrError,
    read_adversary,
    read_car,
    read_clock,
    read_linear,
    read_transforms,
    write_acceleration,
    write_adversary,
    write_car,
    write_car_transform,
    write_clock,
    write_inertia,
    write_velocity,
)
from skd_sim.messages.to_messages import (
    acceleration_command,
    adversary_to_odometry,
    car_to_odometry,
    car_to_transform,
    inertia_to_message,
    to_stamp,
    velocity_command,
)
from skd_sim.sensors import Inertia
from skd_sim.state import AdversaryState, CarState
from tf2_msgs.msg import TFMessage

numbers = st.floats(allow_nan=False, width=64)
stamps = st.integers(0, 2**31 * 10**9 - 1)
FRAMES = [Frames(), Frames("o", "car/base", "front_laser")]  # names of other lengths put the numbers elsewhere
frames = st.text(st.characters(codec="ascii", exclude_characters="\0"), max_size=20)
cars = st.builds(CarState, numbers, numbers, st.floats(-3.14, 3.14), numbers)
adversaries = st.builds(AdversaryState, numbers, numbers, numbers, numbers, st.floats(-3.14, 3.14))


def bits(*values: float) -> bytes:
    return struct.pack(f"{len(values)}d", *values)


def odometry(stamp: int, frame: str, child: str, values: list[float]) -> Odometry:
    """An Odometry in which every number is another, so that one read in the wrong place is seen."""
    message = Odometry()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
    message.header.frame_id, message.child_frame_id = frame, child
    position, orientation = message.pose.pose.position, message.pose.pose.orientation
    position.x, position.y, position.z = values[:3]
    orientation.x, orientation.y, orientation.z, orientation.w = values[3:7]
    message.pose.covariance = values[7:43]
    linear, angular = message.twist.twist.linear, message.twist.twist.angular
    linear.x, linear.y, linear.z = values[43:46]
    angular.x, angular.y, angular.z = values[46:49]
    message.twist.covariance = values[49:85]
    return message


@given(stamp=stamps, frame=frames, child=frames, values=st.lists(numbers, min_size=85, max_size=85))
def test_an_odometry_of_anybody_is_read(stamp, frame, child, values):
    message = odometry(stamp, frame, child, values)
    data = serialize_message(message)
    when, car = read_car(data)
    assert (when, bits(*car)) == (stamp, bits(*odometry_to_car(message)))
    when, adversary = read_adversary(data)
    assert (when, bits(*adversary)) == (stamp, bits(*odometry_to_adversary(message)))


@pytest.mark.parametrize("kind", [AccelStamped, TwistStamped])
@given(stamp=stamps, frame=frames, x=numbers, y=numbers)
def test_a_command_of_anybody_is_read(kind, stamp, frame, x, y):
    message = kind()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
    message.header.frame_id = frame
    linear = (message.accel if kind is AccelStamped else message.twist).linear
    linear.x, linear.y, linear.z = x, y, 7.0
    when, found = read_linear(serialize_message(message))
    assert (when, bits(*found)) == (stamp, bits(x, y))


def test_what_is_not_a_number_arrives_as_such():
    assert math.isnan(read_linear(serialize_message(velocity_command((math.nan, 1.0), 5)))[1][0])


@given(stamp=stamps, car=cars, adversary=adversaries, x=numbers, y=numbers, names=st.sampled_from(FRAMES))
def test_what_is_written_is_what_rclpy_would_have_sent(stamp, car, adversary, x, y, names):
    inertia = Inertia(car.heading, x, (y, car.x, car.y))
    clock, transform = Clock(clock=to_stamp(stamp)), car_to_transform(car, stamp, names)
    pairs: list[tuple[bytes, Any]] = [
        (write_car(car, stamp, names), car_to_odometry(car, stamp, names)),
        (write_adversary(adversary, stamp), adversary_to_odometry(adversary, stamp)),
        (write_inertia(inertia, stamp, names), inertia_to_message(inertia, stamp, names)),
        (write_car_transform(car, stamp, names), transform),
        (write_clock(stamp), clock),
        (write_acceleration(x, stamp), acceleration_command(x, stamp)),
        (write_velocity((x, y), stamp), velocity_command((x, y), stamp)),
    ]
    for data, message in pairs:
        assert deserialize_message(data, type(message)) == message
    for message in (pairs[0][1], pairs[1][1], pairs[2][1], pairs[5][1], pairs[6][1]):
        assert from_stamp(message.header.stamp) == stamp
    assert read_transforms(serialize_message(transform)) == (stamp, None)
    assert read_clock(serialize_message(clock)) == (stamp, None)


def test_no_transform_has_no_stamp():
    assert read_transforms(serialize_message(TFMessage())) == (0, None)


def big_endian(frame: bytes, numbers_: list[float]) -> bytes:
    """An AccelStamped as a machine with the other byte order sends it."""
    head = struct.pack(">BBBBiII", 0, 0, 0, 0, 3, 4, len(frame) + 1) + frame + b"\0"
    return head + b"\0" * (-(len(head) - 4) % 8) + struct.pack(">6d", *numbers_)


def test_the_other_byte_order():
    assert read_linear(big_endian(b"base", [1.5, -2.5, 0.0, 0.0, 0.0, 0.0])) == (3_000_000_004, (1.5, -2.5))


@given(data=st.binary(max_size=900), cut=st.integers(0, 700))
def test_other_bytes_are_refused_or_read_but_never_anything_else(data, cut):
    whole = serialize_message(odometry(1, "map", "base", [float(i) for i in range(85)]))
    with pytest.raises(CdrError, match="bytes are not of its type"):
        read_car(whole[:cut])
    for read in (read_car, read_adversary, read_linear, read_clock, read_transforms):
        try:
            stamp, values = read(data)
        except CdrError:
            continue
        assert isinstance(stamp, int)
        assert values is None or all(isinstance(value, float) for value in values)
