"""Message classes with the behaviour of rclpy's, generated from definitions."""

from __future__ import annotations

import keyword
import threading
from array import array
from collections.abc import Callable
from functools import cache
from typing import Any, ClassVar

import numpy as np
from rosbags.interfaces import Nodetype

from rosless.interfaces import definitions
from rosless.interfaces.definitions import Definition, Field

# base type -> (default value as source text, numpy dtype name, array.array type code)
NUMERIC: dict[str, tuple[str, str, str]] = {
    "int8": ("0", "int8", "b"),
    "uint8": ("0", "uint8", "B"),
    "char": ("0", "uint8", "B"),
    "int16": ("0", "int16", "h"),
    "uint16": ("0", "uint16", "H"),
    "int32": ("0", "int32", "i"),
    "uint32": ("0", "uint32", "I"),
    "int64": ("0", "int64", "q"),
    "uint64": ("0", "uint64", "Q"),
    "float32": ("0.0", "float32", "f"),
    "float64": ("0.0", "float64", "d"),
}
_SCALAR_DEFAULTS = {"bool": "False", "byte": "b'\\x00'", "string": "''"}
_ROS_TYPE_NAMES = {
    "float32": "float",
    "float64": "double",
    "byte": "octet",
    "char": "uint8",
    "bool": "boolean",
}

_lock = threading.RLock()
_classes: dict[str, type[Message]] = {}


class Message:
    """Base of all message classes."""

    __slots__ = ()
    __msgtype__ = ""
    _field_types: ClassVar[dict[str, str]] = {}
    _definition: ClassVar[Definition]

    @classmethod
    def get_fields_and_field_types(cls) -> dict[str, str]:
        """Member names and their types in ROS notation."""
        return dict(cls._field_types)

    def __eq__(self, other: object) -> bool:
        if self.__class__ is not other.__class__:
            return NotImplemented
        return all(_equal(getattr(self, name), getattr(other, name)) for name in self._field_types)

    __hash__ = None  # type: ignore[assignment]  # messages are mutable, as rclpy's

    def __repr__(self) -> str:
        members = ", ".join(f"{name}={_show(getattr(self, name))}" for name in self._field_types)
        return f"{self.__class__.__module__.rpartition('.')[0]}.{self.__class__.__name__}({members})"


def _equal(left: Any, right: Any) -> bool:
    if isinstance(left, (np.ndarray, array)) or isinstance(right, (np.ndarray, array)):
        return len(left) == len(right) and bool(np.array_equal(np.asarray(left), np.asarray(right)))
    return bool(left == right)


def _show(value: Any) -> str:
    if isinstance(value, array):
        return repr(value.tolist())
    return repr(value)


def message_class(name: str) -> type[Any]:
    """The class of ``pkg/msg/Name``; the same object for every call in a process."""
    try:
        return _classes[name]
    except KeyError:
        pass
    with _lock:
        if name not in _classes:
            _classes[name] = _make(definitions.definition(name))
        return _classes[name]


@cache
def service_class(package: str, service: str) -> type:
    """A class with ``Request`` and ``Response``, as rclpy's service types have."""
    request = message_class(f"{package}/srv/{service}_Request")
    response = message_class(f"{package}/srv/{service}_Response")
    members = {"Request": request, "Response": response, "__srvtype__": f"{package}/srv/{service}"}
    return type(service, (), {**members, "__module__": f"{package}.srv._{snake_case(service)}"})


def _make(definition: Definition) -> type[Message]:
    package, kind, short = definition.name.split("/")
    fields = () if definition.is_empty else definition.fields
    names = [attribute_name(field.name) for field in fields]
    if len(names) > 250:
        raise NotImplementedError(f"{definition.name} has {len(names)} members; at most 250 are supported")
    scope: dict[str, Any] = {"np": np, "array": array}
    parameters, body = [], []
    for index, (field, name) in enumerate(zip(fields, names, strict=True)):
        default = _default_source(field, index, scope)
        if _is_immutable(field):
            parameters.append(f"{name}={default}")
            body.append(f"self.{name} = {name}")
        else:
            parameters.append(f"{name}=None")
            body.append(f"self.{name} = {default} if {name} is None else {name}")
    source = (
        f"def __init__(self, {', '.join(parameters)}):\n    " + "\n    ".join(body)
        if body
        else "def __init__(self, structure_needs_at_least_one_member=0):\n    pass"
    )
    exec(compile(source, f"<{definition.name}>", "exec"), scope)
    namespace: dict[str, Any] = {
        "__slots__": tuple(names),
        "__init__": scope["__init__"],
        "__module__": f"{package}.{kind}._{snake_case(short)}",
        "__doc__": f"Message class '{short}'.",
        "__msgtype__": definition.name,
        "_definition": definition,
        "_field_types": {name: ros_type(field) for field, name in zip(fields, names, strict=True)},
    }
    constants = {name: _constant(base, value) for name, base, value in definition.constants}
    if definition.is_empty:
        # rosbags' (de)serialiser reads this member of empty messages
        constants["structure_needs_at_least_one_member"] = 0
    # A constant may not share its name with a slot; rclpy has the member win as well.
    namespace.update({name: value for name, value in constants.items() if name not in names})
    cls = type(short, (Message,), namespace)
    definitions.typestore().types[definition.name] = cls
    return cls


def _constant(base: str, value: Any) -> Any:
    if base == "byte":
        return bytes([int(value)])
    if base in ("float32", "float64"):
        return float(value)
    return value


def _is_immutable(field: Field) -> bool:
    return field.kind == Nodetype.BASE


def _default_source(field: Field, index: int, scope: dict[str, Any]) -> str:
    """Source text of an expression that makes a fresh default value."""
    if field.nested:
        scope[f"class_{index}"] = message_class(field.nested)
        if field.kind == Nodetype.NAME:
            return f"class_{index}()"
        return f"[class_{index}() for _ in range({field.size})]" if field.kind == Nodetype.ARRAY else "[]"
    default = _converted_default(field)
    if field.base in NUMERIC:
        zero, dtype, code = NUMERIC[field.base]
        if field.kind == Nodetype.BASE:
            return zero if default is None else repr(default)
        if field.kind == Nodetype.ARRAY:
            content = repr(default) if default is not None else None
            return f"np.array({content}, np.{dtype})" if content else f"np.zeros({field.size}, np.{dtype})"
        return f"array({code!r}, {default!r})" if default is not None else f"array({code!r})"
    if field.base not in _SCALAR_DEFAULTS:
        raise NotImplementedError(f"members of type {field.base} are not supported ({field.name})")
    if default is not None:
        return repr(default) if field.kind == Nodetype.BASE else f"list({default!r})"
    zero = _SCALAR_DEFAULTS[field.base]
    if field.kind == Nodetype.BASE:
        return zero
    return f"[{zero}] * {field.size}" if field.kind == Nodetype.ARRAY else "[]"


def _converted_default(field: Field) -> Any:
    if field.default is None:
        return None
    converters: dict[str, Callable[[Any], Any]] = {
        "float32": float,
        "float64": float,
        "byte": lambda value: bytes([int(value)]),
    }
    convert = converters.get(field.base)
    if convert is None:
        return field.default
    return [convert(value) for value in field.default] if field.is_collection else convert(field.default)


def ros_type(field: Field) -> str:
    """The type of a member as ``get_fields_and_field_types`` of rclpy's classes writes it."""
    if field.nested:
        package, _, name = field.nested.split("/")
        base = f"{package}/{name}"
    else:
        base = _ROS_TYPE_NAMES.get(field.base, field.base)
        if field.string_bound:
            base = f"string<{field.string_bound}>"
    if field.kind == Nodetype.ARRAY:
        return f"{base}[{field.size}]"
    if field.kind == Nodetype.SEQUENCE:
        return f"sequence<{base}, {field.size}>" if field.size else f"sequence<{base}>"
    return base


def attribute_name(field_name: str) -> str:
    """The attribute of a member: the same name, unless that is a Python keyword."""
    return f"{field_name}_" if keyword.iskeyword(field_name) else field_name


def snake_case(name: str) -> str:
    """``TwistStamped`` -> ``twist_stamped``, as rosidl names its modules."""
    characters: list[str] = []
    for index, character in enumerate(name):
        after_lower = index > 0 and (name[index - 1].islower() or name[index - 1].isdigit())
        before_lower = 0 < index < len(name) - 1 and name[index + 1].islower() and name[index - 1] != "_"
        if character.isupper() and (after_lower or before_lower):
            characters.append("_")
        characters.append(character.lower())
    return "".join(characters)
