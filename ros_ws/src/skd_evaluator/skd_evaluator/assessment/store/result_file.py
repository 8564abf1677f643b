"""The figures of an assessment that is on disk: read through the gate, and each of the type that it has.

What prints them may rely on that: a text where a number belongs is refused here, in one line, and nowhere else.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from skd_sim.errors import UsageError
from skd_sim.inputs.outside import read_json
from skd_sim.inputs.yaml_file import short

from skd_evaluator.assessment.store.schema import assessment_schema

ASSESSMENT = "assessment.json"
_TYPES: dict[str, tuple[type, ...]] = {
    "object": (dict,),
    "array": (list,),
    "string": (str,),
    "number": (int, float),
    "integer": (int,),
    "boolean": (bool,),
    "null": (type(None),),
}


def read_figures(folder: Path) -> dict[str, Any]:
    """Return the content of the assessment.json of a folder.

    Raises:
        UsageError: there is none, it is no JSON, is of another version, or has a value that cannot be there.
    """
    path = folder / ASSESSMENT
    figures: dict[str, Any] = read_json(path)
    if fault := fault_of(figures):
        raise UsageError(f"{path}: no assessment of this version ({fault})")
    return figures


@contextmanager
def understood(path: Path) -> Iterator[None]:
    """Say in one line that a file is no assessment of ours, where that is found while it is used.

    Raises:
        UsageError: a key or an item is not there, or of a kind that nothing can be done with.
    """
    try:
        yield
    except UsageError:
        raise
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, RecursionError) as error:
        said = " ".join(str(error).split())[:120]
        raise UsageError(f"{path}: no assessment of this version ({type(error).__name__}: {said})") from error


def fault_of(figures: Mapping[str, Any]) -> str:
    """Return which value is not as assessment.schema.json has it, in a few words; empty: all are."""
    return _fault(figures, assessment_schema(), "")


def _fault(value: Any, node: Mapping[str, Any], where: str) -> str:
    if "$ref" in node:
        found = _fault(value, assessment_schema()["$defs"][node["$ref"].rpartition("/")[2]], where)
        if found:
            return found
    if "anyOf" in node:
        faults = [_fault(value, branch, where) for branch in node["anyOf"]]
        if all(faults):
            return next((one for one in faults if "must be null" not in one), faults[0])
    wanted = node.get("type", ())
    wanted = (wanted,) if isinstance(wanted, str) else tuple(wanted)
    if wanted and not any(_is(value, one) for one in wanted):
        return f"{where or 'it'} must be {' or '.join(wanted)}, got {short(value)}"
    return _fault_of_value(value, node, where) or _fault_inside(value, node, where)


def _is(value: Any, name: str) -> bool:
    if isinstance(value, bool):
        return name == "boolean"
    return isinstance(value, _TYPES[name])


def _fault_of_value(value: Any, node: Mapping[str, Any], where: str) -> str:
    if "const" in node and value != node["const"]:
        return f"{where} must be {node['const']!r}, got {short(value)}"
    if "enum" in node and value not in node["enum"]:
        return f"{where} must be one of {', '.join(map(str, node['enum']))}, got {short(value)}"
    if isinstance(value, str) and "pattern" in node and not re.search(node["pattern"], value):
        return f"{where} is not as such a text has to be: {short(value)}"
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        if "minimum" in node and value < node["minimum"]:
            return f"{where} must be at least {node['minimum']}, got {short(value)}"
        if "exclusiveMinimum" in node and value <= node["exclusiveMinimum"]:
            return f"{where} must be greater than {node['exclusiveMinimum']}, got {short(value)}"
        if "maximum" in node and value > node["maximum"]:
            return f"{where} must be at most {node['maximum']}, got {short(value)}"
    if isinstance(value, list) and not node.get("minItems", 0) <= len(value) <= node.get("maxItems", len(value)):
        return f"{where} has {len(value)} items, which it cannot"
    return ""


def _fault_inside(value: Any, node: Mapping[str, Any], where: str) -> str:
    parts: list[tuple[str, Any, Any]] = []
    if isinstance(value, dict):
        known, others = node.get("properties", {}), node.get("additionalProperties")
        if lacking := next((name for name in node.get("required", ()) if name not in value), ""):
            return f"{where or 'it'} has no {lacking}"
        parts = [(f"{where}.{short(key)[1:-1]}", one, known.get(key, others)) for key, one in value.items()]
    elif isinstance(value, list):
        parts = [(f"{where}.{place}", one, node.get("items")) for place, one in enumerate(value)]
    inside = (_fault(one, schema, path.lstrip(".")) for path, one, schema in parts if isinstance(schema, Mapping))
    return next(filter(None, inside), "")
