"""Outside data checked against models: pydantic validates them, and a mistake is one line.

A model is a frozen dataclass with annotations. Its JSON schema (`schema_of`) has ranges, units and names, and says in
a message what would be right.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Hashable, Iterable, Sequence
from typing import Annotated, Any, Self, TypeVar, cast

from pydantic import ConfigDict, Field, StrictBool, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError, core_schema

from skd_sim.errors import UsageError
from skd_sim.inputs.files import did_you_mean, near_or_all
from skd_sim.inputs.yaml_file import name_of_key, short

Model = TypeVar("Model")
YesNo = StrictBool
"""True or false, and neither 1 nor `yes`."""
Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Count = Annotated[int, Field(strict=True, ge=0, le=2**63 - 1)]


ON_LANE = ("lane", "along", "aside")
"""Keys that say where something is by a lane of the road, in place of its coordinates."""


class Frozen:
    """Base of an immutable model: unknown keys are refused, and a deep copy is the object itself."""

    __slots__ = ()
    __pydantic_config__ = ConfigDict(extra="forbid")

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self


def plain(model: Any, empty: tuple[Any, ...] = (None, ())) -> dict[str, Any]:
    """Return a model as nested plain data, without the keys whose values are empty: those that a file leaves out."""
    return dataclasses.asdict(model, dict_factory=lambda items: {key: one for key, one in items if one not in empty})


class OnLane(Frozen):
    """Base of a section whose place a file may give by a lane (`scenario/shorthand.py`), in place of coordinates."""

    __slots__ = ()
    __pydantic_config__ = ConfigDict(extra="forbid", json_schema_extra={"also": [*ON_LANE]})


def limits(low: float | None = None, high: float | None = None, unit: str = "") -> Any:
    """Return the annotation of a finite number: its range, ends included, and its unit."""
    more: dict[str, Any] = {"allow_inf_nan": False} if high is None else {}
    return Field(ge=low, le=high, strict=True, json_schema_extra={"unit": unit} if unit else {}, **more)


class OneOf:
    """The annotation of a text that is one of some names, which are looked up whenever a text is checked."""

    def __init__(self, names: Iterable[str]) -> None:
        """Allow these names."""
        self._names = names

    def _check(self, name: str) -> str:
        if name not in self._names:
            raise PydanticCustomError("unknown_name", "none of the names")
        return name

    def __get_pydantic_core_schema__(self, *_: Any) -> core_schema.CoreSchema:
        return core_schema.no_info_after_validator_function(self._check, core_schema.str_schema(strict=True))

    def __get_pydantic_json_schema__(self, *_: Any) -> dict[str, Any]:
        return {"type": "string", "enum": list(self._names)}


def plain_type(kind: type[Any], low: float | None, high: float | None, names: Any) -> Any:
    """Return the annotation of a plain value.

    Args:
        kind: bool, int, float, str, or tuple of texts.
        low: least number allowed.
        high: greatest number allowed.
        names: texts that are allowed, of which each can be listed; None: any.
    """
    if kind is bool:
        return YesNo
    if kind in (int, float):
        return Annotated[kind, limits(low, high)]
    if kind is tuple:
        return tuple[str, ...]
    return str if names is None else Annotated[str, OneOf(names)]


@functools.cache
def _adapter(kind: Hashable) -> TypeAdapter[Any]:
    return TypeAdapter(cast(type[Any], kind))


def schema_of(kind: Hashable) -> dict[str, Any]:
    """Return the JSON schema of a model."""
    return _adapter(kind).json_schema()


def read_model(kind: type[Model], data: Any, where: str, path: str = "") -> Model:
    """Return an object of a model from plain data.

    Args:
        kind: the model.
        data: nested mappings and lists.
        where: file or other origin, for messages.
        path: name of the section that the data are, for messages.

    Raises:
        UsageError: a key is missing or unknown, or a value is wrong; names file and key, and says what would be right.
    """
    try:
        model: Model = _adapter(cast(Hashable, kind)).validate_python(data)
    except ValidationError as error:
        # Of a typo there are two errors, and the unknown key says more than the missing one.
        errors = sorted(
            error.errors(include_url=False), key=lambda one: (not _is_unknown(one), one["type"] != "missing")
        )
        raise UsageError(f"{where}: {_worded(errors[0], schema_of(cast(Hashable, kind)), path)}") from None
    return model


_UNKNOWN = ("unexpected_keyword_argument", "extra_forbidden", "invalid_key")


def _is_unknown(error: ErrorDetails) -> bool:
    """Return whether a key is none of those that there are."""
    return error["type"] in _UNKNOWN or error["loc"][-1:] == ("[key]",)


def _worded(error: ErrorDetails, schema: dict[str, Any], path: str) -> str:
    """Return what is wrong, where, and what would be right."""
    kind, given, place = error["type"], error["input"], error["loc"]
    if _is_unknown(error):
        place = place[:-1] if place[-1] == "[key]" else place
        section = _node(schema, place[:-1])
        known = [*section.get("properties", section.get("propertyNames", {}).get("enum", ())), *section.get("also", ())]
        return f"unknown key {_joined(path, place)}{near_or_all(str(place[-1]), known, 'allowed:')}"
    key = _joined(path, place)
    if kind == "missing" and not isinstance(place[-1], int):
        return f"missing key {key}"
    if kind == "value_error":  # of a check of the model's own, which says by its own keys what is wrong
        return ": ".join(filter(None, (key, str(error["ctx"]["error"]))))
    if kind == "missing":  # a list that is too short
        return f"{_joined(path, place[:-1])} must be {_right(_node(schema, place[:-1]))}, got {short(given)}"
    right = _right(_node(schema, place))
    if right in (_LIST, _MAPPING) or (right.startswith(_LIST) and not isinstance(given, list)):
        return f"{key or 'the file'} must be {right}, got {type(given).__name__}"
    known = _node(schema, place).get("enum", ())
    return f"{key} must be {right}, got {short(given)}{did_you_mean(given, known) if isinstance(given, str) else ''}"


_LIST, _MAPPING = "a list", "a mapping"
_ENDS = ("minimum", "maximum")


def _right(node: dict[str, Any]) -> str:
    """Return what a value has to be by its JSON schema."""
    kind = node.get("type")
    if "enum" in node or "const" in node:
        return f"one of {', '.join(map(str, node.get('enum', [node.get('const')])))}"
    if kind in ("number", "integer"):
        whole = kind == "integer"
        low, high = (None if key not in node else int(node[key]) if whole else f"{node[key]:g}" for key in _ENDS)
        span = "" if low is None else f" ≥ {low}" if high is None else f" from {low} to {high}"
        number = "a whole number" if whole else "a number" if span else "a finite number"
        return f"{number}{span} ({node['unit']})" if "unit" in node else f"{number}{span}"
    if "prefixItems" in node:
        return f"a list of {len(node['prefixItems'])} numbers"
    if "minItems" in node:
        return f"{_LIST} of at least {node['minItems']}"
    return {"string": "text", "boolean": "true or false", "array": _LIST}.get(str(kind), _MAPPING)


def _node(schema: dict[str, Any], place: Sequence[int | str]) -> dict[str, Any]:
    """Return the part of a JSON schema that describes a place in the data."""
    node = schema
    for step in (None, *place):
        if isinstance(step, int):
            node = node["prefixItems"][step] if "prefixItems" in node else node["items"]
        elif step is not None:
            node = node["properties"][step] if "properties" in node else node["additionalProperties"]
        node = node.get("anyOf", [node])[0]  # an optional value is this, or null
        if "$ref" in node:
            node = schema["$defs"][node["$ref"].rpartition("/")[2]]
    return node


def _joined(path: str, place: Sequence[int | str]) -> str:
    for step in place:
        dot = "." if path and isinstance(step, str) else ""
        path += f"[{step}]" if isinstance(step, int) else f"{dot}{name_of_key(step)}"
    return path
