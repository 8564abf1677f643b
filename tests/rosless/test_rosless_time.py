"""Times, durations and clocks."""

from __future__ import annotations

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosless.clock import Clock, ROSClock
from rosless.duration import Duration, Infinite
from rosless.interfaces.classes import message_class
from rosless.time import ClockType, Time

NANOSECONDS = st.integers(0, 2**61)


@given(NANOSECONDS, NANOSECONDS)
def test_arithmetic(left: int, right: int) -> None:
    a, b = Time(nanoseconds=left), Time(nanoseconds=right)
    assert (a - b).nanoseconds == left - right
    assert (a < b, a <= b, a == b, a != b) == (left < right, left <= right, left == right, left != right)
    assert (a + Duration(nanoseconds=right)).nanoseconds == left + right
    assert (Duration(nanoseconds=right) + a).nanoseconds == left + right


@given(st.integers(0, 2**31 * 10**9 - 1))
def test_messages_keep_every_nanosecond(nanoseconds: int) -> None:
    stamp = Time(nanoseconds=nanoseconds, clock_type=ClockType.ROS_TIME)
    assert Time.from_msg(stamp.to_msg()) == stamp
    duration = Duration(nanoseconds=-nanoseconds)
    assert Duration.from_msg(duration.to_msg()) == duration


def test_clock_types_do_not_mix() -> None:
    steady = Time(nanoseconds=1, clock_type=ClockType.STEADY_TIME)
    for operation in ("__eq__", "__lt__", "__ge__", "__sub__"):
        with pytest.raises(TypeError):
            getattr(steady, operation)(Time(nanoseconds=1))


def test_limits() -> None:
    with pytest.raises(ValueError, match="negative"):
        Time(nanoseconds=-1)
    with pytest.raises(OverflowError):
        Time(nanoseconds=2**63)
    with pytest.raises(ValueError, match="negative time"):
        Time(nanoseconds=1) - Duration(nanoseconds=2)
    with pytest.raises(OverflowError):
        Duration(seconds=2**40)
    with pytest.raises(TypeError):
        Time(clock_type=1)  # type: ignore[arg-type]
    with pytest.raises(TypeError):
        Time.from_msg(message_class("builtin_interfaces/msg/Duration")())


def test_text() -> None:
    assert repr(Time(seconds=1.5)) == "Time(nanoseconds=1500000000, clock_type=SYSTEM_TIME)"
    assert str(Infinite) == "Infinite"
    assert Time(seconds=2, nanoseconds=3).seconds_nanoseconds() == (2, 3)


def test_clocks() -> None:
    assert isinstance(Clock(clock_type=ClockType.ROS_TIME), ROSClock)
    assert abs(Clock().now().nanoseconds - time.time_ns()) < 10**9
    assert abs(Clock(clock_type=ClockType.STEADY_TIME).now().nanoseconds - time.monotonic_ns()) < 10**9
    clock = ROSClock()
    assert abs(clock.now().nanoseconds - time.time_ns()) < 10**9
    clock._set_ros_time_is_active(True)
    assert clock.now().nanoseconds == 0
    clock.set_ros_time_override(Time(nanoseconds=5))
    assert clock.now() == Time(nanoseconds=5, clock_type=ClockType.ROS_TIME)
