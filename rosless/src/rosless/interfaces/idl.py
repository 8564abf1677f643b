"""Descriptions of message types for Cyclone DDS.

Cyclone validates what is written against these and compares them with those of the other side, so that a type
mismatch surfaces as an incompatibility instead of garbage. Serialisation is not theirs: see :mod:`cdr`.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from cyclonedds.idl import IdlStruct, make_idl_struct
from cyclonedds.idl import types as _typed_idl_types
from rosbags.interfaces import Nodetype

from rosless.interfaces import definitions
from rosless.interfaces.definitions import Definition, Field

# its generics are made by __class_getitem__, which type checkers do not accept on plain classes
idl_types: Any = _typed_idl_types

_NUMBERS = ("int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "float32", "float64")
_PRIMITIVES: dict[str, Any] = {
    "bool": bool,
    "byte": idl_types.byte,
    "char": idl_types.uint8,
    "string": str,
    **{name: getattr(idl_types, name) for name in _NUMBERS},
}

_REQUEST_ID_FIELDS: dict[str, Any] = {"rosless_client": idl_types.uint64, "rosless_sequence": idl_types.int64}


def dds_type_name(name: str) -> str:
    """``pkg/msg/Name`` -> ``pkg::msg::dds_::Name_``."""
    package, kind, short = name.split("/")
    return f"{package}::{kind}::dds_::{short}_"


def ros_type_name(dds_name: str) -> str | None:
    """``pkg::msg::dds_::Name_`` -> ``pkg/msg/Name``, or None if it is no name of that form."""
    parts = dds_name.split("::")
    if len(parts) != 4 or parts[2] != "dds_" or not parts[3].endswith("_"):
        return None
    return f"{parts[0]}/{parts[1]}/{parts[3][:-1]}"


@cache
def idl_struct(name: str) -> type[IdlStruct]:
    """The Cyclone DDS type of ``pkg/msg/Name``."""
    return _make(definitions.definition(name), {})


@cache
def service_struct(name: str) -> type[IdlStruct]:
    """As :func:`idl_struct` for one half of a service: the request id comes before the members."""
    return _make(definitions.definition(name), _REQUEST_ID_FIELDS)


def _make(definition: Definition, first: dict[str, Any]) -> type[IdlStruct]:
    fields = {**first, **{field.name: _idl_type(field) for field in definition.fields}}
    class_name = definition.name.rpartition("/")[2] + "_"
    return make_idl_struct(class_name, dds_type_name(definition.name).replace("::", "."), fields)


def _idl_type(field: Field) -> Any:
    item = idl_struct(field.nested) if field.nested else _PRIMITIVES.get(field.base)
    if item is None:
        raise NotImplementedError(f"members of type {field.base} are not supported ({field.name})")
    if field.string_bound:
        item = idl_types.bounded_str[field.string_bound]
    if field.kind == Nodetype.ARRAY:
        return idl_types.array[item, field.size]
    if field.kind == Nodetype.SEQUENCE:
        return idl_types.sequence[item, field.size] if field.size else idl_types.sequence[item]
    return item
