"""Builds dataclasses from a validated mapping: every key known, in range, and there unless it has a default."""

from __future__ import annotations

import dataclasses
import functools
import types
from collections.abc import Hashable, Mapping
from typing import Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

from skd_sim.choices.suggestion import did_you_mean
from skd_sim.errors import UsageError
from skd_sim.inputs.keys import Choice
from skd_sim.inputs.yaml_file import name_of_key, short

Section = TypeVar("Section")


def build(kind: type[Section], data: Any, where: str, path: str) -> Section:
    """Build dataclass `kind` from a mapping, or raise UsageError naming the file, the key and its range."""
    prefix = f"{path}." if path else ""
    if not isinstance(data, Mapping):
        raise UsageError(f"{where}: {path or 'the file'} must be a mapping, got {type(data).__name__}")
    fields = {field.name: field for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    unknown = [key for key in data if key not in fields]
    if unknown:
        key, known = name_of_key(unknown[0]), [*fields, *getattr(kind, "also", ())]
        raise UsageError(f"{where}: unknown key {prefix}{key}; allowed: {', '.join(known)}{did_you_mean(key, known)}")
    hints = _hints_of(cast(Hashable, kind))
    values: dict[str, Any] = {}
    for name in fields:
        if name not in data:
            if fields[name].default is not dataclasses.MISSING:
                continue
            raise UsageError(f"{where}: missing key {prefix}{name}")
        values[name] = _value(hints[name], data[name], where, f"{prefix}{name}")
    return kind(**values)


@functools.cache
def _hints_of(kind: type[Any]) -> dict[str, Any]:
    """Return the types of a dataclass's fields, which are evaluated from texts: that takes longer than all the rest."""
    return get_type_hints(kind, include_extras=True)


def _value(kind: Any, value: Any, where: str, key: str) -> Any:
    if dataclasses.is_dataclass(kind):
        return build(cast(type[Any], kind), value, where, key)
    if get_origin(kind) in (types.UnionType, Union):  # an optional section or key that is there
        return _value(get_args(kind)[0], value, where, key)
    if get_origin(kind) is tuple:
        if not isinstance(value, (list, tuple)):
            raise UsageError(f"{where}: {key} must be a list, got {type(value).__name__}")
        return tuple(_value(get_args(kind)[0], item, where, f"{key}[{index}]") for index, item in enumerate(value))
    if kind is str:
        if not isinstance(value, str):
            raise UsageError(f"{where}: {key} must be text, got {short(value)}")
        return value
    if kind is bool:
        if not isinstance(value, bool):
            raise UsageError(f"{where}: {key} must be true or false, got {short(value)}")
        return value
    limits = kind.__metadata__[0]
    if isinstance(limits, Choice):
        if value not in limits.names:
            raise UsageError(f"{where}: {key} must be one of {', '.join(limits.names)}; got {short(value)}")
        return value
    low, high, unit = limits.low, limits.high, limits.unit
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not number or not low <= value <= high:
        raise UsageError(f"{where}: {key} must be a number from {low:g} to {high:g} ({unit}), got {short(value)}")
    if kind.__origin__ is int:
        if value != int(value):
            raise UsageError(f"{where}: {key} must be a whole number ({unit}), got {short(value)}")
        return int(value)
    return float(value)
