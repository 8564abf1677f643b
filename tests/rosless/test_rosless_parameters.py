"""Parameters of a node, against the documented behaviour of rclpy."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from rosless.context import Context
from rosless.exceptions import (
    InvalidParameterException,
    InvalidParameterTypeException,
    InvalidParameterValueException,
    ParameterAlreadyDeclaredException,
    ParameterImmutableException,
    ParameterNotDeclaredException,
    ParameterUninitializedException,
)
from rosless.interfaces.classes import message_class
from rosless.node import Node
from rosless.parameters.parameter import Parameter, get_parameter_value, parameter_value_to_python

Descriptor = message_class("rcl_interfaces/msg/ParameterDescriptor")
FloatingPointRange = message_class("rcl_interfaces/msg/FloatingPointRange")
IntegerRange = message_class("rcl_interfaces/msg/IntegerRange")
SetParametersResult = message_class("rcl_interfaces/msg/SetParametersResult")


@pytest.fixture
def node(context: Context) -> Iterator[Node]:
    made = Node("car", context=context)
    yield made
    made.destroy_node()


@pytest.mark.parametrize(
    ("value", "type_"),
    [
        (None, "NOT_SET"), (True, "BOOL"), (1, "INTEGER"), (1.0, "DOUBLE"), ("a", "STRING"),
        ([], "BYTE_ARRAY"), ([b"a"], "BYTE_ARRAY"), ([True], "BOOL_ARRAY"), ([1], "INTEGER_ARRAY"),
        ([1.0], "DOUBLE_ARRAY"),
        (["a"], "STRING_ARRAY"), ((1, 2), "INTEGER_ARRAY"),
    ],
)  # fmt: skip
def test_types_follow_from_values(value: Any, type_: str) -> None:
    parameter = Parameter("a", value=value)
    assert parameter.type_ is Parameter.Type[type_]
    back = Parameter.from_parameter_msg(parameter.to_parameter_msg())
    assert (back.name, back.type_) == (parameter.name, parameter.type_)
    assert back.value == (list(value) if isinstance(value, tuple) else value)


def test_values_without_a_type() -> None:
    for value in ({}, [1, "a"], [1.0, 1], object()):
        with pytest.raises(TypeError):
            Parameter("a", value=value)
    with pytest.raises(ValueError, match="do not agree"):
        Parameter("a", Parameter.Type.DOUBLE, 1)
    with pytest.raises(TypeError):
        Parameter("a", "DOUBLE", 1.0)  # type: ignore[arg-type]


def test_text_becomes_a_value() -> None:
    texts = ["1", "1.5", "on", "[1, 2]", "x: 1"]
    values = [parameter_value_to_python(get_parameter_value(text)) for text in texts]
    assert values == [1, 1.5, True, [1, 2], "x: 1"]


def test_declaring(node: Node) -> None:
    assert node.declare_parameter("speed", 2.5).value == 2.5
    assert node.get_parameter("speed").value == 2.5
    assert node.has_parameter("speed")
    with pytest.raises(ParameterAlreadyDeclaredException):
        node.declare_parameter("speed", 1.0)
    with pytest.raises(InvalidParameterException):
        node.declare_parameter("", 1.0)
    with pytest.raises(ParameterNotDeclaredException):
        node.get_parameter("other")
    assert node.get_parameter_or("other", Parameter("x", value=1)).value == 1
    declared = node.declare_parameters("a", [("b", 1), ("c", "x", Descriptor(description="what"))])
    assert [parameter.name for parameter in declared] == ["a.b", "a.c"]
    assert node.describe_parameter("a.c").description == "what"
    assert {name: p.value for name, p in node.get_parameters_by_prefix("a").items()} == {"b": 1, "c": "x"}


def test_types_are_static(node: Node) -> None:
    node.declare_parameter("speed", 2.5)
    result = node.set_parameters([Parameter("speed", value=3)])[0]
    assert not result.successful
    assert result.reason == "Wrong parameter type, expected 'Type.DOUBLE' got 'Type.INTEGER'"
    assert not node.set_parameters([Parameter("speed")])[0].successful
    assert node.get_parameter("speed").value == 2.5


def test_dynamic_types_and_deletion(node: Node) -> None:
    node.declare_parameter("any", 1, Descriptor(dynamic_typing=True))
    assert node.set_parameters([Parameter("any", value="text")])[0].successful
    assert node.describe_parameter("any").type == Parameter.Type.STRING.value
    assert node.set_parameters([Parameter("any")])[0].successful
    assert not node.has_parameter("any")


def test_types_without_value(node: Node) -> None:
    node.declare_parameter("speed", Parameter.Type.DOUBLE)
    with pytest.raises(ParameterUninitializedException):
        node.get_parameter("speed")
    assert node.get_parameter_or("speed").type_ is Parameter.Type.NOT_SET
    assert node.set_parameters([Parameter("speed", value=1.0)])[0].successful
    assert node.get_parameter("speed").value == 1.0
    with pytest.raises(ValueError, match="statically typed"):
        node.declare_parameter("nothing", None, Descriptor())
    with pytest.warns(UserWarning, match="deprecated"):
        node.declare_parameter("bare")


def test_read_only(node: Node) -> None:
    node.declare_parameter("speed", 2.5, Descriptor(read_only=True))
    result = node.set_parameters([Parameter("speed", value=3.0)])[0]
    assert (result.successful, result.reason) == (False, "Trying to set a read-only parameter: speed.")
    with pytest.raises(ParameterImmutableException):
        node.undeclare_parameter("speed")
    with pytest.raises(ParameterImmutableException):
        node.set_descriptor("speed", Descriptor())


@pytest.mark.parametrize(
    ("value", "fits"), [(0.0, True), (1.0, True), (0.25, True), (0.3, False), (-0.1, False), (1.1, False)]
)
def test_ranges_of_doubles(node: Node, value: float, fits: bool) -> None:
    limits = FloatingPointRange(from_value=0.0, to_value=1.0, step=0.25)
    node.declare_parameter("gain", 0.5, Descriptor(floating_point_range=[limits]))
    assert node.set_parameters([Parameter("gain", value=value)])[0].successful is fits


@pytest.mark.parametrize(("value", "fits"), [(0, True), (10, True), (5, True), (7, False), (-1, False), (11, False)])
def test_ranges_of_integers(node: Node, value: int, fits: bool) -> None:
    node.declare_parameter("n", 5, Descriptor(integer_range=[IntegerRange(from_value=0, to_value=10, step=5)]))
    assert node.set_parameters([Parameter("n", value=value)])[0].successful is fits


def test_defaults_must_be_in_range(node: Node) -> None:
    limits = IntegerRange(from_value=0, to_value=10)
    with pytest.raises(InvalidParameterValueException, match="out of range"):
        node.declare_parameter("n", 11, Descriptor(integer_range=[limits]))
    assert not node.has_parameter("n")


def test_overrides(context: Context) -> None:
    overrides = [Parameter("speed", value=3.0), Parameter("count", value=1), Parameter("extra", value="x")]
    node = Node("car", context=context, parameter_overrides=overrides)
    assert node.declare_parameter("speed", 1.0).value == 3.0
    assert node.declare_parameter("other", 1.0, ignore_override=True).value == 1.0
    with pytest.raises(InvalidParameterTypeException, match="expecting type 'STRING'"):
        node.declare_parameter("count", "text")
    assert not node.has_parameter("extra")
    automatic = Node(
        "bus",
        context=context,
        parameter_overrides=overrides,
        automatically_declare_parameters_from_overrides=True,
    )
    assert automatic.get_parameter("extra").value == "x"


def test_overrides_from_arguments(context: Context) -> None:
    node = Node(
        "car",
        context=context,
        cli_args=["-p", "speed:=3.5", "-p", "car:names:=[a, b]", "-p", "bus:speed:=1.0"],
    )
    assert node.declare_parameter("speed", 1.0).value == 3.5
    assert node.declare_parameter("names", [""]).value == ["a", "b"]


def test_undeclared_parameters_can_be_allowed(context: Context) -> None:
    node = Node("car", context=context, allow_undeclared_parameters=True)
    assert node.get_parameter("a").type_ is Parameter.Type.NOT_SET
    assert node.set_parameters([Parameter("a", value=1)])[0].successful
    assert node.get_parameter("a").value == 1
    strict = Node("bus", context=context)
    with pytest.raises(ParameterNotDeclaredException):
        strict.set_parameters([Parameter("a", value=1)])


def test_callbacks(node: Node) -> None:
    node.declare_parameters("", [("a", 1), ("b", 2)])
    seen: list[Any] = []

    def check(parameters: list[Parameter]) -> Any:
        return SetParametersResult(successful=all(p.value < 10 for p in parameters), reason="too large")

    def double(parameters: list[Parameter]) -> list[Parameter]:
        return [Parameter(p.name, value=2 * p.value) for p in parameters]

    node.add_on_set_parameters_callback(check)
    node.add_post_set_parameters_callback(lambda parameters: seen.extend((p.name, p.value) for p in parameters))
    assert not node.set_parameters_atomically([Parameter("a", value=3), Parameter("b", value=10)]).successful
    assert node.get_parameter("a").value == 1
    node.add_pre_set_parameters_callback(double)
    assert node.set_parameters([Parameter("a", value=4)])[0].successful
    assert seen == [("a", 8)]
    node.remove_pre_set_parameters_callback(double)
    node.add_pre_set_parameters_callback(lambda _: [])
    assert "empty" in node.set_parameters([Parameter("a", value=4)])[0].reason
    node.remove_on_set_parameters_callback(check)
    with pytest.raises(ValueError, match="not in list"):
        node.remove_on_set_parameters_callback(check)


def test_callbacks_may_refuse_a_declaration(node: Node) -> None:
    node.add_on_set_parameters_callback(lambda _: SetParametersResult(successful=False, reason="no"))
    with pytest.raises(InvalidParameterValueException, match="Reason: no"):
        node.declare_parameter("a", 1)


def test_listing(node: Node) -> None:
    node.declare_parameters("", [("a", 1), ("b.c", 1), ("b.d.e", 1)])
    everything = node.list_parameters([], 0)
    assert {"a", "b.c", "b.d.e", "use_sim_time"} <= set(everything.names)
    assert everything.prefixes == ["b", "b.d"]
    assert "b.c" not in node.list_parameters([], 1).names
    assert node.list_parameters(["b"], 1).names == ["b.c"]
    assert node.list_parameters(["b"], 0).names == ["b.c", "b.d.e"]


def test_new_descriptors(node: Node) -> None:
    node.declare_parameter("n", 11)
    limits = Descriptor(integer_range=[IntegerRange(from_value=0, to_value=10)], type=Parameter.Type.INTEGER.value)
    with pytest.raises(InvalidParameterValueException):
        node.set_descriptor("n", limits)
    value = node.set_descriptor("n", limits, Parameter("n", value=3).get_parameter_value())
    assert value.integer_value == 3
    assert node.get_parameter("n").value == 3


def test_undeclaring(node: Node) -> None:
    node.declare_parameter("a", 1)
    node.undeclare_parameter("a")
    assert not node.has_parameter("a")
    with pytest.raises(ParameterNotDeclaredException):
        node.undeclare_parameter("a")


def test_use_sim_time_must_be_a_bool(node: Node) -> None:
    assert node.get_parameter("use_sim_time").value is False
    assert not node.set_parameters([Parameter("use_sim_time", value="yes")])[0].successful
    assert node.set_parameters([Parameter("use_sim_time", value=True)])[0].successful
    assert node.get_clock().ros_time_is_active
