"""The bytes of messages: the same as rosbags' typestore with its own classes makes."""

from __future__ import annotations

import contextlib
import copy
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosless.interfaces import cdr, definitions
from rosless.interfaces.classes import message_class
from rosless_message_strategies import build, contents, fresh_typestore

REFERENCE = fresh_typestore()
SKD_MSGS = Path(__file__).resolve().parents[2] / "ros_ws" / "src" / "skd_msgs"
GRAPH_TYPES = [
    "builtin_interfaces/msg/Time",
    "geometry_msgs/msg/AccelStamped",
    "geometry_msgs/msg/Twist",
    "geometry_msgs/msg/TwistStamped",
    "nav_msgs/msg/Odometry",
    "rcl_interfaces/msg/ParameterEvent",
    "rosgraph_msgs/msg/Clock",
    "std_msgs/msg/Header",
    "visualization_msgs/msg/MarkerArray",
]


def _reference_bytes(name: str, values: dict[str, Any]) -> bytes:
    return bytes(REFERENCE.serialize_cdr(build(REFERENCE, name, values), name))


def _check(name: str, values: dict[str, Any]) -> None:
    message = build(REFERENCE, name, values, ours=message_class)
    expected = _reference_bytes(name, values)
    assert cdr.serialize(message) == expected
    # read back and written again, from bytes in either order
    assert cdr.serialize(cdr.deserialize(expected, name)) == expected
    swapped = bytes(REFERENCE.serialize_cdr(build(REFERENCE, name, values), name, little_endian=False))
    assert cdr.serialize(cdr.deserialize(swapped, name)) == expected


@pytest.mark.parametrize("name", GRAPH_TYPES)
def test_random_content_has_the_bytes_of_rosbags(name: str) -> None:
    @settings(max_examples=25, suppress_health_check=list(HealthCheck), database=None)
    @given(contents(REFERENCE, name))
    def check(values: dict[str, Any]) -> None:
        _check(name, values)

    check()


@pytest.mark.parametrize("name", sorted(REFERENCE.fielddefs))
def test_every_standard_type_round_trips(name: str) -> None:
    if definitions.definition(name).is_empty:
        assert cdr.serialize(message_class(name)()) == b"\0\1\0\0\0"
        return

    @settings(max_examples=2, suppress_health_check=list(HealthCheck), database=None)
    @given(contents(REFERENCE, name))
    def check(values: dict[str, Any]) -> None:
        _check(name, values)

    check()


@pytest.mark.skipif(not list(SKD_MSGS.glob("msg/*.msg")), reason="ros_ws/src/skd_msgs has no messages yet")
def test_the_projects_own_messages_have_the_bytes_of_rosbags() -> None:
    from rosbags.typesys import get_types_from_msg

    store = fresh_typestore()
    types: dict[str, Any] = {}
    for path in sorted((SKD_MSGS / "msg").glob("*.msg")):
        types.update(get_types_from_msg(path.read_text(), f"skd_msgs/msg/{path.stem}"))
    store.register(types)
    for name in types:

        @settings(max_examples=25, suppress_health_check=list(HealthCheck), database=None)
        @given(contents(store, name))
        def check(values: dict[str, Any]) -> None:
            message = build(store, name, values, ours=message_class)  # noqa: B023
            reference = build(store, name, values)  # noqa: B023
            assert cdr.serialize(message) == bytes(store.serialize_cdr(reference, name))  # noqa: B023

        check()
        for constant, _, value in types[name][0]:
            assert getattr(message_class(name), constant) == value


def test_defaults_are_those_of_the_definitions() -> None:
    pose = message_class("geometry_msgs/msg/Pose")()
    assert pose.orientation.w == 1.0
    values = {
        "position": {"x": 0.0, "y": 0.0, "z": 0.0},
        "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
    }
    assert cdr.serialize(pose) == _reference_bytes("geometry_msgs/msg/Pose", values)
    first, second = message_class("nav_msgs/msg/Odometry")(), message_class("nav_msgs/msg/Odometry")()
    assert first.pose.covariance is not second.pose.covariance
    assert first == second


@pytest.mark.parametrize(
    ("name", "path", "value"),
    [
        ("nav_msgs/msg/Odometry", "pose.pose.position.x", 3),
        ("nav_msgs/msg/Odometry", "pose.pose.position.x", True),
        ("nav_msgs/msg/Odometry", "pose.pose.position.x", None),
        ("nav_msgs/msg/Odometry", "pose.covariance", [0] * 36),
        ("nav_msgs/msg/Odometry", "pose.covariance", np.zeros(36, int)),
        ("nav_msgs/msg/Odometry", "pose.covariance", np.zeros(35)),
        ("nav_msgs/msg/Odometry", "pose.covariance", np.zeros((6, 6))),
        ("nav_msgs/msg/Odometry", "child_frame_id", 3),
        ("nav_msgs/msg/Odometry", "child_frame_id", b"map"),
        ("nav_msgs/msg/Odometry", "header", None),
        ("nav_msgs/msg/Odometry", "header.stamp.sec", 1.0),
        ("nav_msgs/msg/Odometry", "header.stamp.sec", 2**31),
        ("nav_msgs/msg/Odometry", "header.stamp.nanosec", -1),
        ("geometry_msgs/msg/AccelStamped", "accel.linear.x", 1),
        ("geometry_msgs/msg/TwistStamped", "twist.linear.x", np.float32(1)),
        ("visualization_msgs/msg/Marker", "color.r", 1),
        ("visualization_msgs/msg/Marker", "color.r", 1e300),
        ("visualization_msgs/msg/Marker", "frame_locked", 1),
        ("visualization_msgs/msg/Marker", "points", [(0.0, 0.0)]),
        ("sensor_msgs/msg/LaserScan", "ranges", [1, 2]),
        ("sensor_msgs/msg/LaserScan", "ranges", "12"),
    ],
)
def test_a_wrong_value_is_a_type_error_that_says_where(name: str, path: str, value: object) -> None:
    message = message_class(name)()
    target, *parents = reversed(path.split("."))
    owner: Any = message
    for part in reversed(parents):
        owner = getattr(owner, part)
    setattr(owner, target, value)
    with pytest.raises(TypeError) as caught:
        cdr.serialize(message)
    assert f"{name}: member '{path}'" in str(caught.value)


@pytest.mark.parametrize("value", [np.float64(2.5), 2.5, math.inf, math.nan])
def test_values_that_are_floats_are_floats(value: float) -> None:
    message = message_class("geometry_msgs/msg/Point")(x=value)
    result = cdr.deserialize(cdr.serialize(message), "geometry_msgs/msg/Point").x
    assert result == value or (math.isnan(value) and math.isnan(result))


@given(st.lists(st.floats(width=32), max_size=5))
def test_sequences_take_lists_tuples_and_arrays(values: list[float]) -> None:
    from array import array

    name = "sensor_msgs/msg/LaserScan"
    forms = [values, tuple(values), array("f", values), np.array(values, np.float32), np.array(values, float)]
    assert len({cdr.serialize(message_class(name)(ranges=form)) for form in forms}) == 1


def test_arrays_that_arrive_are_writable() -> None:
    name = "nav_msgs/msg/Odometry"
    message = cdr.deserialize(cdr.serialize(message_class(name)()), name)
    message.pose.covariance[7] = 1.5
    assert message.pose.covariance[7] == 1.5
    scan = cdr.deserialize(
        cdr.serialize(message_class("sensor_msgs/msg/LaserScan")(ranges=[1.0])), "sensor_msgs/msg/LaserScan"
    )
    scan.ranges.append(2.0)
    assert list(scan.ranges) == [1.0, 2.0]


@given(st.binary(max_size=80))
def test_damaged_bytes_are_one_kind_of_error(data: bytes) -> None:
    for name in ("visualization_msgs/msg/MarkerArray", "nav_msgs/msg/Odometry"):
        with contextlib.suppress(cdr.DeserializationError):
            cdr.deserialize(b"\0\1\0\0" + data, name)


def test_messages_can_be_copied_compared_and_shown() -> None:
    message = message_class("geometry_msgs/msg/PoseStamped")()
    other = copy.deepcopy(message)
    assert other == message
    other.pose.position.x = 1.0
    assert other != message
    assert message != "something else"
    assert repr(message_class("geometry_msgs/msg/Point")()) == "geometry_msgs.msg.Point(x=0.0, y=0.0, z=0.0)"
    with pytest.raises(AttributeError):
        message.positoin = None
    with pytest.raises(TypeError):
        message_class("geometry_msgs/msg/Point")(w=1.0)
    assert message_class("nav_msgs/msg/Odometry").get_fields_and_field_types() == {
        "header": "std_msgs/Header",
        "child_frame_id": "string",
        "pose": "geometry_msgs/PoseWithCovariance",
        "twist": "geometry_msgs/TwistWithCovariance",
    }
    types = message_class("geometry_msgs/msg/PoseWithCovariance").get_fields_and_field_types()
    assert types["covariance"] == "double[36]"


def test_constants_are_class_attributes() -> None:
    marker = message_class("visualization_msgs/msg/Marker")
    assert (marker.ARROW, marker.CUBE, marker.DELETEALL) == (0, 1, 3)
    assert message_class("diagnostic_msgs/msg/DiagnosticStatus").WARN == b"\x01"
