"""rclpy.parameter: a named value with one of ROS's parameter types."""

from __future__ import annotations

from array import array
from enum import Enum
from typing import Any

import numpy as np

from rosless.interfaces.classes import message_class
from rosless.parameters import yaml_values

PARAMETER_SEPARATOR_STRING = "."


class ParameterType(Enum):
    """The types of rcl_interfaces/msg/ParameterType."""

    NOT_SET = 0
    BOOL = 1
    INTEGER = 2
    DOUBLE = 3
    STRING = 4
    BYTE_ARRAY = 5
    BOOL_ARRAY = 6
    INTEGER_ARRAY = 7
    DOUBLE_ARRAY = 8
    STRING_ARRAY = 9

    @classmethod
    def from_parameter_value(cls, parameter_value: Any) -> ParameterType:
        """The type of a Python value; TypeError if it has none."""
        if parameter_value is None:
            return cls.NOT_SET
        for item_class, scalar, _ in _PYTHON_TYPES[1:]:
            if isinstance(parameter_value, item_class):
                return scalar
        if not isinstance(parameter_value, (list, tuple, array)):
            raise TypeError(f"The given value is not one of the allowed types '{parameter_value}'.")
        for item_class, _, collection in _PYTHON_TYPES:
            if all(isinstance(item, item_class) for item in parameter_value):
                return collection
        raise TypeError(f"The given value is not a list of one of the allowed types '{parameter_value}'.")

    def check(self, parameter_value: Any) -> bool:
        """True if a value is of this type."""
        if self is ParameterType.NOT_SET:
            return parameter_value is None
        for item_class, scalar, collection in _PYTHON_TYPES:
            if self is scalar and item_class is not bytes:
                return isinstance(parameter_value, item_class)
            if self is collection:
                kinds = (list, tuple, array) if item_class in (int, float) else (list, tuple)
                return isinstance(parameter_value, kinds) and all(
                    isinstance(item, item_class) and (item_class is not bytes or len(item) == 1)
                    for item in parameter_value
                )
        return False


# so that it shows itself as rclpy's does
ParameterType.__name__, ParameterType.__qualname__ = "Type", "Parameter.Type"

# class of an item, type of a scalar of it, type of a list of it; bool is an int, so it comes first
_PYTHON_TYPES: tuple[tuple[type[Any], ParameterType, ParameterType], ...] = (
    (bytes, ParameterType.NOT_SET, ParameterType.BYTE_ARRAY),
    (bool, ParameterType.BOOL, ParameterType.BOOL_ARRAY),
    (int, ParameterType.INTEGER, ParameterType.INTEGER_ARRAY),
    (float, ParameterType.DOUBLE, ParameterType.DOUBLE_ARRAY),
    (str, ParameterType.STRING, ParameterType.STRING_ARRAY),
)

# type -> member of rcl_interfaces/msg/ParameterValue that holds its value
_MEMBERS = {
    ParameterType.BOOL: "bool_value",
    ParameterType.INTEGER: "integer_value",
    ParameterType.DOUBLE: "double_value",
    ParameterType.STRING: "string_value",
    ParameterType.BYTE_ARRAY: "byte_array_value",
    ParameterType.BOOL_ARRAY: "bool_array_value",
    ParameterType.INTEGER_ARRAY: "integer_array_value",
    ParameterType.DOUBLE_ARRAY: "double_array_value",
    ParameterType.STRING_ARRAY: "string_array_value",
}


class Parameter:
    """A name, a type and a value that agree."""

    Type = ParameterType

    def __init__(self, name: str, type_: ParameterType | None = None, value: Any = None) -> None:
        if type_ is None:
            type_ = ParameterType.from_parameter_value(value)
        if not isinstance(type_, ParameterType):
            raise TypeError(f"type must be an instance of '{ParameterType!r}'")
        if not type_.check(value):
            raise ValueError(f"Type '{type_}' and value '{value}' do not agree")
        self._type_ = type_
        self._name = name
        self._value = value

    @classmethod
    def from_parameter_msg(cls, param_msg: Any) -> Parameter:
        """From rcl_interfaces/msg/Parameter."""
        type_ = ParameterType(param_msg.value.type)
        return cls(param_msg.name, type_, parameter_value_to_python(param_msg.value))

    @property
    def name(self) -> str:
        """The parameter's name."""
        return self._name

    @property
    def type_(self) -> ParameterType:
        """The parameter's type."""
        return self._type_

    @property
    def value(self) -> Any:
        """The parameter's value."""
        return self._value

    def __repr__(self) -> str:
        return f"Parameter(name={self._name!r}, type={self._type_.name}, value={self._value!r})"

    def get_parameter_value(self) -> Any:
        """As rcl_interfaces/msg/ParameterValue."""
        message = message_class("rcl_interfaces/msg/ParameterValue")(type=self._type_.value)
        if self._type_ in _MEMBERS:
            value = list(self._value) if isinstance(self._value, tuple) else self._value
            setattr(message, _MEMBERS[self._type_], value)
        return message

    def to_parameter_msg(self) -> Any:
        """As rcl_interfaces/msg/Parameter."""
        return message_class("rcl_interfaces/msg/Parameter")(name=self._name, value=self.get_parameter_value())


def parameter_value_to_python(parameter_value: Any) -> Any:
    """The Python value in an rcl_interfaces/msg/ParameterValue."""
    try:
        type_ = ParameterType(parameter_value.type)
    except ValueError:
        raise RuntimeError(f"unexpected parameter type {parameter_value.type}") from None
    if type_ is ParameterType.NOT_SET:
        return None
    value = getattr(parameter_value, _MEMBERS[type_])
    return value.tolist() if isinstance(value, (np.ndarray, array)) else value


def get_parameter_value(string_value: str) -> Any:
    """Guess the ParameterValue that a text stands for, by the rules of YAML."""
    try:
        value = yaml_values.parse(string_value)
        parameter = Parameter("", value=value)
    except (yaml_values.YamlError, TypeError):
        parameter = Parameter("", value=string_value)
    if parameter.type_ is ParameterType.NOT_SET:
        parameter = Parameter("", value=string_value)
    return parameter.get_parameter_value()


def parameter_dict_from_yaml_file(
    parameter_file: str,
    use_wildcard: bool = False,
    target_nodes: list[str] | None = None,
    namespace: str = "",
) -> dict[str, Any]:
    """rcl_interfaces/msg/Parameter messages by name, from a parameter file."""
    nodes = yaml_values.load_file(parameter_file)
    keys = ["/**"] if use_wildcard and "/**" in nodes else []
    if target_nodes:
        for node in target_nodes:
            name = yaml_values.absolute(node)
            if name not in nodes:
                raise RuntimeError(f"Param file does not contain parameters for {node}, only for nodes: {list(nodes)}")
            keys.append(name)
    else:
        keys += [key for key in nodes if key != "/**"]
    if not keys:
        raise RuntimeError("Param file does not contain selected parameters")
    values = {name: value for key in keys for name, value in nodes[key].items()}
    return {
        namespace + name: Parameter(namespace + name, value=value).to_parameter_msg() for name, value in values.items()
    }
