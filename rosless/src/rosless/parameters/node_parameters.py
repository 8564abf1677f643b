"""The parameter methods of rclpy's Node."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rosless.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
    ParameterAlreadyDeclaredException,
    ParameterImmutableException,
    ParameterNotDeclaredException,
    ParameterUninitializedException,
)
from rosless.interfaces.classes import message_class
from rosless.names import validate_parameter_name
from rosless.parameters import descriptors as descriptor_rules
from rosless.parameters.parameter import PARAMETER_SEPARATOR_STRING, Parameter, parameter_value_to_python

if TYPE_CHECKING:
    from rosless.parameters.events import ParameterEvents

_DEPTH_RECURSIVE = 0

PreSetCallback = Callable[[list[Parameter]], list[Parameter]]
OnSetCallback = Callable[[list[Parameter]], Any]
PostSetCallback = Callable[[list[Parameter]], None]


def _descriptor(**members: Any) -> Any:
    return message_class("rcl_interfaces/msg/ParameterDescriptor")(**members)


def _result(reason: str = "") -> Any:
    return message_class("rcl_interfaces/msg/SetParametersResult")(successful=not reason, reason=reason)


class NodeParameters:
    """Declares, checks and changes the parameters of a node."""

    def __init__(self, overrides: dict[str, Parameter], *, allow_undeclared: bool) -> None:
        self._parameters: dict[str, Parameter] = {}
        self._descriptors: dict[str, Any] = {}
        self._parameter_overrides = overrides
        self._allow_undeclared_parameters = allow_undeclared
        self._pre_set_parameters_callbacks: list[PreSetCallback] = []
        self._on_set_parameters_callbacks: list[OnSetCallback] = []
        self._post_set_parameters_callbacks: list[PostSetCallback] = []
        self._parameter_events: ParameterEvents | None = None

    # Declaring

    def declare_parameter(
        self, name: str, value: Any = None, descriptor: Any = None, ignore_override: bool = False
    ) -> Parameter:
        """Declare a parameter; the value is that of the overrides, or this one."""
        arguments: tuple[Any, ...]
        if value is None and descriptor is None:
            arguments = (name,)
        else:
            arguments = (name, value, _descriptor() if descriptor is None else descriptor)
        return self.declare_parameters("", [arguments], ignore_override)[0]

    def declare_parameters(
        self, namespace: str, parameters: list[tuple[Any, ...]], ignore_override: bool = False
    ) -> list[Parameter]:
        """Declare parameters given as (name), (name, value or type) or (name, value or type, descriptor)."""
        declared: list[Parameter] = []
        descriptors: dict[str, Any] = {}
        for index, entry in enumerate(parameters):
            parameter, descriptor = self._declaration(namespace, index, entry, ignore_override)
            declared.append(parameter)
            descriptors[parameter.name] = descriptor
        known = [parameter.name for parameter in declared if parameter.name in self._parameters]
        if known:
            raise ParameterAlreadyDeclaredException(known)
        for parameter in declared:
            result = self._set([parameter], descriptors, allow_not_set=True)
            if result.successful:
                continue
            if result.reason.startswith("Wrong parameter type"):
                expected = Parameter.Type(descriptors[parameter.name].type).name
                raise InvalidParameterTypeException(parameter, expected)
            raise InvalidParameterValueException(parameter.name, parameter.value, result.reason)
        return [self._parameters[parameter.name] for parameter in declared]

    def _declaration(
        self, namespace: str, index: int, entry: tuple[Any, ...], ignore_override: bool
    ) -> tuple[Parameter, Any]:
        where = f"at index {index} in parameters list"
        if not 1 <= len(entry) <= 3:
            raise TypeError(f"Invalid parameter tuple length {where}: {entry}; expecting length between 1 and 3")
        name = entry[0]
        if not isinstance(name, str):
            raise TypeError(f"First element {name} {where} is not a str.")
        name = f"{namespace}.{name}" if namespace else name
        validate_parameter_name(name)
        value = entry[1] if len(entry) > 1 else None
        descriptor = entry[2] if len(entry) > 2 else _descriptor()
        if not isinstance(descriptor, message_class("rcl_interfaces/msg/ParameterDescriptor")):
            raise TypeError(f"Third element {descriptor} {where} is not a ParameterDescriptor.")
        if len(entry) == 1:
            warnings.warn(
                f"when declaring parameter named '{name}', declaring a parameter only providing its name is "
                "deprecated. You have to either:\n"
                '\t- Pass a name and a default value different to "PARAMETER NOT SET" '
                "(and optionally a descriptor).\n"
                "\t- Pass a name and a parameter type.\n"
                "\t- Pass a name and a descriptor with `dynamic_typing=True",
                stacklevel=4,
            )
            descriptor.dynamic_typing = True
        if isinstance(value, Parameter.Type):
            if value is Parameter.Type.NOT_SET:
                raise ValueError(f"Cannot declare parameter {{{name}}} as statically typed of type NOT_SET")
            if descriptor.dynamic_typing:
                raise ValueError(
                    f"When declaring parameter {{{name}}} passing a descriptor with"
                    "`dynamic_typing=True` is not allowed when the parameter type is provided"
                )
            descriptor.type = value.value
            value = None
        else:
            if isinstance(value, message_class("rcl_interfaces/msg/ParameterValue")):
                value = parameter_value_to_python(value)
            if not descriptor.dynamic_typing:
                descriptor.type = Parameter.Type.from_parameter_value(value).value
                if descriptor.type == Parameter.Type.NOT_SET.value:
                    raise ValueError(
                        "Cannot declare a statically typed parameter with default value of type PARAMETER_NOT_SET"
                    )
        if not ignore_override and name in self._parameter_overrides:
            return _adapted(self._parameter_overrides[name], descriptor), descriptor
        return Parameter(name, value=value) if value != [] else _empty(name, descriptor), descriptor

    def undeclare_parameter(self, name: str) -> None:
        """Take a declaration back."""
        if not self.has_parameter(name):
            raise ParameterNotDeclaredException(name)
        if self._descriptors[name].read_only:
            raise ParameterImmutableException(name)
        del self._parameters[name]
        del self._descriptors[name]

    # Reading

    def has_parameter(self, name: str) -> bool:
        """True if a parameter is declared."""
        return name in self._parameters

    def get_parameter(self, name: str) -> Parameter:
        """A declared parameter."""
        parameter = self._parameters.get(name)
        if parameter is None:
            if self._allow_undeclared_parameters:
                return Parameter(name, Parameter.Type.NOT_SET)
            raise ParameterNotDeclaredException(name)
        if parameter.type_ is Parameter.Type.NOT_SET and not self._descriptors[name].dynamic_typing:
            raise ParameterUninitializedException(name)
        return parameter

    def get_parameters(self, names: list[str]) -> list[Parameter]:
        """Declared parameters."""
        if not all(isinstance(name, str) for name in names):
            raise TypeError("All names must be instances of type str")
        return [self.get_parameter(name) for name in names]

    def get_parameter_or(self, name: str, alternative_value: Parameter | None = None) -> Parameter:
        """A parameter, or the alternative if it is not declared or has no value."""
        parameter = self._parameters.get(name)
        if parameter is not None and parameter.type_ is not Parameter.Type.NOT_SET:
            return parameter
        return Parameter(name, Parameter.Type.NOT_SET) if alternative_value is None else alternative_value

    def get_parameter_type(self, name: str) -> Any:
        """The type of a parameter."""
        if self.has_parameter(name):
            return self._parameters[name].type_.value
        if self._allow_undeclared_parameters:
            return Parameter.Type.NOT_SET
        raise ParameterNotDeclaredException(name)

    def get_parameter_types(self, names: list[str]) -> list[Any]:
        """The types of parameters."""
        if not all(isinstance(name, str) for name in names):
            raise TypeError("All names must be instances of type str")
        return [self.get_parameter_type(name) for name in names]

    def get_parameters_by_prefix(self, prefix: str) -> dict[str, Parameter]:
        """The parameters below a prefix, by the rest of their names."""
        start = f"{prefix}{PARAMETER_SEPARATOR_STRING}" if prefix else ""
        return {name[len(start) :]: value for name, value in self._parameters.items() if name.startswith(start)}

    def list_parameters(self, prefixes: list[str], depth: int) -> Any:
        """Names below some prefixes, up to a depth (0 is all)."""
        if not isinstance(prefixes, list):
            raise TypeError("The prefixes argument must be a list")
        if not all(isinstance(prefix, str) for prefix in prefixes):
            raise TypeError("All prefixes must be instances of type str")
        if not isinstance(depth, int):
            raise TypeError("The depth must be instance of type int")
        if depth < 0:
            raise ValueError("The depth must be greater than or equal to zero")

        def shallow(name: str) -> bool:
            return depth == _DEPTH_RECURSIVE or name.count(PARAMETER_SEPARATOR_STRING) < depth

        def wanted(name: str) -> bool:
            if not prefixes:
                return shallow(name)
            starts = [prefix + PARAMETER_SEPARATOR_STRING for prefix in prefixes]
            return name in prefixes or any(name.startswith(start) and shallow(name[len(start) :]) for start in starts)

        result = message_class("rcl_interfaces/msg/ListParametersResult")()
        result.names = [name for name in self._parameters if wanted(name)]
        parents = (name.rpartition(PARAMETER_SEPARATOR_STRING)[0] for name in result.names)
        result.prefixes = list(dict.fromkeys(parent for parent in parents if parent))
        return result

    def describe_parameter(self, name: str) -> Any:
        """The descriptor of a parameter."""
        if name in self._descriptors:
            return self._descriptors[name]
        if self._allow_undeclared_parameters:
            return _descriptor()
        raise ParameterNotDeclaredException(name)

    def describe_parameters(self, names: list[str]) -> list[Any]:
        """The descriptors of parameters."""
        return [self.describe_parameter(name) for name in names]

    # Changing

    def set_parameters(self, parameter_list: list[Parameter]) -> list[Any]:
        """Set parameters one after the other; one result each."""
        return [self.set_parameters_atomically([parameter]) for parameter in parameter_list]

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> Any:
        """Set all of these parameters, or none."""
        if self._pre_set_parameters_callbacks:
            given = parameter_list
            parameter_list = [item for callback in self._pre_set_parameters_callbacks for item in callback(given)]
            if not parameter_list:
                return _result(
                    "parameter list cannot be empty, this might be due to "
                    "pre_set_parameters_callback modifying the original parameters list."
                )
        if not all(isinstance(parameter, Parameter) for parameter in parameter_list):
            raise TypeError(f"parameter must be instance of type '{Parameter!r}'")
        undeclared = [parameter.name for parameter in parameter_list if parameter.name not in self._parameters]
        if undeclared and not self._allow_undeclared_parameters:
            raise ParameterNotDeclaredException(undeclared)
        return self._set(parameter_list)

    def _set(
        self,
        parameters: list[Parameter],
        descriptors: dict[str, Any] | None = None,
        *,
        allow_not_set: bool = False,
    ) -> Any:
        rules = self._descriptors if descriptors is None else descriptors
        for parameter in parameters:
            if parameter.name in rules:
                reason = self._problem(parameter, rules[parameter.name], check_read_only=descriptors is None)
                if reason:
                    return _result(reason)
        for callback in self._on_set_parameters_callbacks:
            result = callback(parameters)
            if not result.successful:
                return result
        events = self._parameter_events.collect() if self._parameter_events is not None else None
        for parameter in parameters:
            name = parameter.name
            if parameter.type_ is Parameter.Type.NOT_SET and not allow_not_set:
                self._parameters.pop(name, None)
                self._descriptors.pop(name, None)
                if events is not None:
                    events.deleted_parameters.append(parameter.to_parameter_msg())
                continue
            if descriptors is not None:
                self._descriptors[name] = descriptors[name]
            elif name not in self._descriptors:
                self._descriptors[name] = _descriptor(name=name, type=parameter.type_.value, dynamic_typing=True)
            if events is not None:
                is_new = self.get_parameter_or(name).type_ is Parameter.Type.NOT_SET
                changes = events.new_parameters if is_new else events.changed_parameters
                changes.append(parameter.to_parameter_msg())
            self._parameters[name] = parameter
        if self._parameter_events is not None:
            self._parameter_events.publish(events)
        for post_callback in self._post_set_parameters_callbacks:
            post_callback(parameters)
        return _result()

    def _problem(self, parameter: Parameter, descriptor: Any, *, check_read_only: bool) -> str:
        return descriptor_rules.problem(
            parameter,
            descriptor,
            declared=self.has_parameter(parameter.name),
            check_read_only=check_read_only,
        )

    def set_descriptor(self, name: str, descriptor: Any, alternative_value: Any = None) -> Any:
        """Give a parameter a new descriptor, and the alternative value if its own does not fit that."""
        if not self.has_parameter(name):
            if not self._allow_undeclared_parameters:
                raise ParameterNotDeclaredException(name)
            return self.get_parameter(name).get_parameter_value()
        if self._descriptors[name].read_only:
            raise ParameterImmutableException(name)
        parameter = self.get_parameter(name)
        if self._problem(parameter, descriptor, check_read_only=False):
            if alternative_value is not None:
                parameter = Parameter(name, value=parameter_value_to_python(alternative_value))
            reason = self._problem(parameter, descriptor, check_read_only=False)
            if reason:
                raise InvalidParameterValueException(name, parameter.value, reason)
        self._parameters[name] = parameter
        self._descriptors[name] = descriptor
        return parameter.get_parameter_value()

    # Callbacks

    def add_pre_set_parameters_callback(self, callback: PreSetCallback) -> None:
        """Have a function change what is about to be set."""
        self._pre_set_parameters_callbacks.insert(0, callback)

    def add_on_set_parameters_callback(self, callback: OnSetCallback) -> None:
        """Have a function accept or refuse what is about to be set."""
        self._on_set_parameters_callbacks.insert(0, callback)

    def add_post_set_parameters_callback(self, callback: PostSetCallback) -> None:
        """Have a function called after parameters were set."""
        self._post_set_parameters_callbacks.insert(0, callback)

    def remove_pre_set_parameters_callback(self, callback: PreSetCallback) -> None:
        """Take a callback back."""
        self._pre_set_parameters_callbacks.remove(callback)

    def remove_on_set_parameters_callback(self, callback: OnSetCallback) -> None:
        """Take a callback back."""
        self._on_set_parameters_callbacks.remove(callback)

    def remove_post_set_parameters_callback(self, callback: PostSetCallback) -> None:
        """Take a callback back."""
        self._post_set_parameters_callbacks.remove(callback)


def _adapted(override: Parameter, descriptor: Any) -> Parameter:
    # an empty list on the command line has no type of its own
    return _empty(override.name, descriptor) if override.value == [] else override


def _empty(name: str, descriptor: Any) -> Parameter:
    declared = Parameter.Type(descriptor.type)
    is_list = declared.name.endswith("_ARRAY") and not descriptor.dynamic_typing
    return Parameter(name, declared if is_list else None, [])
