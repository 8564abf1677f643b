"""Commands in messages of any type: the number at a path is what was put there, and what is wrong is said in a line."""

import math

import pytest
from ackermann_msgs.msg import AckermannDriveStamped
from builtin_interfaces.msg import Time
from common import refused
from geometry_msgs.msg import AccelStamped, TwistStamped
from hypothesis import given
from hypothesis import strategies as st
from nav_msgs.msg import Path
from sensor_msgs.msg import Joy
from skd_sim.options.options import CommandOptions
from skd_sim.ros.commands import NAMED_FORMATS, CarCommands, Quantity, angle_of_yaw_rate, car_commands
from std_msgs.msg import Float64MultiArray, Header

NUMBERS = st.floats(-(2.0**100), 2.0**100, width=32)


def commands(kind: str, field: str = "", quantity: str = "acceleration") -> CarCommands:
    return car_commands(CommandOptions(command_type=kind, command_field=field, command_quantity=quantity))


@given(value=NUMBERS, other=NUMBERS, sec=st.integers(0, 2**31 - 1), nanosec=st.integers(0, 10**9 - 1), name=st.text())
def test_the_number_at_the_path_is_read(value: float, other: float, sec: int, nanosec: int, name: str) -> None:
    name = name.replace("\0", "")
    header = Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=name)
    accel, twist = AccelStamped(header=header), TwistStamped(header=header)
    accel.accel.linear.x = twist.twist.linear.x = value
    accel.accel.linear.y = accel.accel.linear.z = twist.twist.linear.z = other
    joy = Joy(header=header, axes=[other, value, other], buttons=[3])
    array = Float64MultiArray(data=[value, other])
    array.layout.data_offset = 7
    stamp = sec * 10**9 + nanosec
    for chosen, message, expected in (
        (commands("accel_stamped"), accel, (stamp, value)),
        (commands("geometry_msgs/msg/AccelStamped", "accel.linear.x"), accel, (stamp, value)),
        (commands("geometry_msgs/msg/AccelStamped", "accel.linear.z"), accel, (stamp, other)),
        (commands("twist_stamped"), twist, (stamp, value)),
        (commands("twist"), twist.twist, (None, value)),
        (commands("sensor_msgs/msg/Joy", "axes[1]"), joy, (stamp, value)),
        (commands("sensor_msgs/msg/Joy", "buttons[0]"), joy, (stamp, 3.0)),
        (commands("std_msgs/msg/Float64MultiArray", "data[0]"), array, (None, value)),
        (commands("std_msgs/msg/Float64MultiArray", "layout.data_offset"), array, (None, 7.0)),
    ):
        assert chosen.kind is type(message)
        assert chosen.stamped == (expected[0] is not None)
        assert chosen.read(message) == (expected[0], (expected[1], 0.0, 0.0))
    drive = AckermannDriveStamped(header=header)
    drive.drive.speed, drive.drive.acceleration, drive.drive.jerk = value, abs(other), 9.0
    drive.drive.steering_angle = accel.accel.angular.z = twist.twist.angular.z = other
    assert commands("ackermann").read(drive) == (stamp, (value, abs(other), other))
    assert commands("accel_stamped").read(accel) == (stamp, (value, 0.0, other))
    assert commands("twist_stamped").read(twist) == (stamp, (value, 0.0, other))
    assert commands("twist").read(twist.twist) == (None, (value, 0.0, other))
    both = CommandOptions(command_type="sensor_msgs/msg/Joy", command_field="axes[1]", command_steering="axes[0]")
    assert car_commands(both).read(joy) == (stamp, (value, 0.0, other))


def test_a_yaw_rate_is_that_of_the_car() -> None:
    angle = angle_of_yaw_rate(0.4, 8.0, 2.6)
    assert 8.0 * math.tan(angle) / 2.6 == pytest.approx(0.4)
    assert commands("twist").format.is_yaw_rate
    assert not commands("ackermann").format.is_yaw_rate


def test_what_a_type_means() -> None:
    assert commands("accel_stamped").format.quantity == Quantity.ACCELERATION
    assert commands("twist").format.quantity == Quantity.SPEED
    assert commands("geometry_msgs/msg/Twist", "linear.x").format.quantity == Quantity.ACCELERATION
    assert commands("geometry_msgs/msg/Twist", "linear.x", "speed").format.quantity == Quantity.SPEED


@pytest.mark.parametrize(
    ("kind", "field", "said"),
    [
        ("joy", "", f"must be one of {', '.join(NAMED_FORMATS)}, or a message type as in my_msgs/msg/Command"),
        ("twist", "linear.x", "command_field and command_steering go with a type of yours"),
        ("no_such_msgs/msg/Joy", "axes[0]", "no message package no_such_msgs here"),
        ("geometry_msgs/msg/Force", "x", "geometry_msgs has no such message; it has Accel, AccelStamped, "),
        ("geometry_msgs/msg/AccelStamped", "", "its numbers are accel.linear.x, accel.linear.y, accel.linear.z, "),
        ("geometry_msgs/msg/AccelStamped", "accel.linear.w",
         "there is no number accel.linear.w in geometry_msgs/msg/AccelStamped; its numbers are accel.linear.x, "),
        ("geometry_msgs/msg/AccelStamped", "accel.linear.x[0]", "there is no number accel.linear.x[0] in "),
        ("geometry_msgs/msg/AccelStamped", "header.frame_id", "there is no number header.frame_id in "),
        ("sensor_msgs/msg/Joy", "axes", "its numbers are axes[0], buttons[0]"),
        ("sensor_msgs/msg/Imu", "orientation_covariance[9]", "there is no number orientation_covariance[9] in "),
        ("std_msgs/msg/Bool", "data", "there is no number data in std_msgs/msg/Bool; its numbers are none"),
        ("nav_msgs/msg/Path", "poses[2].pose.position.w", "poses[0].pose.position.x, poses[0].pose.position.y"),
    ],
)  # fmt: skip
def test_a_wrong_type_or_field_is_one_line(kind: str, field: str, said: str) -> None:
    with refused(said) as caught:
        commands(kind, field)
    assert len(str(caught.value)) < 1200


def test_a_message_without_the_element_is_left_out() -> None:
    read = commands("nav_msgs/msg/Path", "poses[2].pose.position.x").read
    with pytest.raises(IndexError):
        read(Path())
