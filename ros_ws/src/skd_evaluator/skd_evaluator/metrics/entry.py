"""Entries of assessment.json: an object's keys are fields and properties, whose types and docstrings are its schema."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator, Mapping
from functools import cached_property
from operator import attrgetter
from types import NoneType
from typing import Annotated, Any, ClassVar, get_args, get_origin, get_type_hints

import numpy as np

from skd_evaluator.metrics.statistics import Interval

Schema = Mapping[str, Any]
Share = Annotated[float, "rate"]
"""A number from 0 to 1."""


def ref(name: str) -> Schema:
    """Return a schema that is one of the schema's `$defs`."""
    return {"$ref": f"#/$defs/{name}"}


def or_null(schema: Schema) -> Schema:
    """Return a schema of what may be null."""
    return {"anyOf": [{"type": "null"}, schema]}


def object_of(properties: Mapping[str, Schema]) -> dict[str, Any]:
    """Return the schema of an object that has just these."""
    return {"type": "object", "properties": properties, "required": [*properties], "additionalProperties": False}


class Entry:
    """What stands in assessment.json as an object."""

    KEYS: ClassVar[str] = ""
    """Its keys, each the name of a field or property, or followed by `=` and the path to one."""

    @classmethod
    def _paths(cls) -> Iterator[tuple[str, str]]:
        for key, _, path in (word.partition("=") for word in cls.KEYS.split()):
            yield key, path or key

    def as_dict(self) -> dict[str, Any]:
        """Return the entry."""
        return {key: _plain(attrgetter(path)(self)) for key, path in self._paths()}

    @classmethod
    def schema(cls) -> dict[str, Any]:
        """Return the JSON Schema of the entry."""
        members = {key: _member(cls, path) for key, path in cls._paths()}
        return object_of({key: {**_schema(hint), "description": says} for key, (hint, says) in members.items()})


def _plain(value: Any) -> Any:
    if isinstance(value, Entry):
        return value.as_dict()
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        is_interval = isinstance(value, tuple) and len(value) == 2 and all(isinstance(one, float) for one in value)
        return value if is_interval else [_plain(one) for one in value]
    return value


def _member(owner: type, path: str) -> tuple[Any, str]:
    """Return the type of a field or property, and what its docstring says."""
    name, _, rest = path.partition(".")
    found = inspect.getattr_static(owner, name, None)
    getter = found.fget if isinstance(found, property) else found.func if isinstance(found, cached_property) else None
    if getter is not None:
        hint, text = get_type_hints(getter, include_extras=True)["return"], inspect.getdoc(getter) or ""
    else:
        hint, pattern = get_type_hints(owner, include_extras=True)[name], rf"^    {name}: (.+?)(?=\n    \w+: |\n\S|\Z)"
        known = re.search(pattern, inspect.getdoc(owner) or "", re.MULTILINE | re.DOTALL)
        text = known[1] if known else ""
    if rest:
        return _member(hint, rest)
    return hint, " ".join(text.partition("\n\n")[0].replace("None", "null").split()).rstrip(".")


_PLAIN: Mapping[Any, tuple[Schema, Schema]] = {
    float: (ref("number"), ref("number_or_null")),
    Share: (ref("rate"), ref("rate")),
    Interval: (ref("interval"), ref("interval")),
    int: ({"type": "integer", "minimum": 0}, {"type": ["integer", "null"], "minimum": 0}),
    bool: ({"type": "boolean"}, {"type": ["boolean", "null"]}),
    str: ({"type": "string"}, {"type": ["string", "null"]}),
}
"""Schemas by type: of one that is always there, and of one that may be null."""


def _schema(hint: Any) -> Schema:
    """Return the schema of a type."""
    some = [one for one in get_args(hint) if one is not NoneType]
    null = NoneType in get_args(hint)
    kind = some[0] if null else hint
    if kind in _PLAIN:
        return _PLAIN[kind][null]
    if isinstance(kind, type) and issubclass(kind, Entry):
        return or_null(kind.schema()) if null else kind.schema()
    if issubclass(get_origin(kind) or kind, Mapping):
        return {"type": "object"}
    return {"type": "array", "items": _schema(get_args(kind)[0])}
