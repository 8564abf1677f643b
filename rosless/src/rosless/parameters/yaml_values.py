"""Parameter values in YAML, typed as ROS types them.

ROS reads a plain scalar as bool, integer, double or string by rules of its own (``yes`` is a bool, ``010``
is 8), so the YAML library is used for the structure only.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

_TRUE = frozenset(["y", "Y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON"])
_FALSE = frozenset(["n", "N", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF"])
_INTEGER = re.compile(r"[+-]?(0[xX][0-9a-fA-F]+|[0-9]+)")
_FLOAT = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")
_SPECIAL_FLOATS = {
    ".nan": float("nan"), ".NaN": float("nan"), ".NAN": float("nan"),
    ".inf": float("inf"), ".Inf": float("inf"), ".INF": float("inf"),
    "+.inf": float("inf"), "+.Inf": float("inf"), "+.INF": float("inf"),
    "-.inf": float("-inf"), "-.Inf": float("-inf"), "-.INF": float("-inf"),
}  # fmt: skip

# Texts that are surely one plain scalar; for them the YAML library need not even be imported.
_PLAIN = re.compile(r"[A-Za-z0-9_./+][A-Za-z0-9_./+-]*|-[0-9.][A-Za-z0-9_./+-]*")

_PARAMETERS_KEY = "ros__parameters"


class YamlError(ValueError):
    """Text that is no valid value or parameter file."""


def parse(text: str) -> Any:
    """The value of one parameter: a scalar, or a list of scalars of one type."""
    if _PLAIN.fullmatch(text):
        return scalar(text)
    node = _compose(text, f"value {text!r}")
    if node is None:
        return ""
    return _value(node, f"value {text!r}")


def scalar(text: str) -> bool | int | float | str:
    """The value of a plain (unquoted) scalar."""
    if text in _TRUE:
        return True
    if text in _FALSE:
        return False
    if _INTEGER.fullmatch(text):
        value = _integer(text)
        if value is not None and -(2**63) <= value < 2**63:
            return value
    if text in _SPECIAL_FLOATS:
        return _SPECIAL_FLOATS[text]
    return float(text) if _FLOAT.fullmatch(text) else text


def _integer(text: str) -> int | None:
    digits = text.lstrip("+-").lower()
    sign = -1 if text.startswith("-") else 1
    if digits.startswith("0x"):
        return sign * int(digits, 16)
    if len(digits) > 1 and digits.startswith("0"):
        return sign * int(digits, 8) if not set(digits) & set("89") else None
    return sign * int(digits)


def load_file(path: str | Path) -> dict[str, dict[str, Any]]:
    """Parameters by absolute node name (or pattern), in the order of the file."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise YamlError(f"cannot read the parameter file {path}: {error.strerror}") from error
    node = _compose(text, f"parameter file {path}")
    result: dict[str, dict[str, Any]] = {}
    if node is not None:
        _collect_nodes(node, "", result, str(path))
    return result


def absolute(name: str) -> str:
    """A node name with a leading slash."""
    return name if name.startswith("/") else f"/{name}"


def node_name_matches(pattern: str, name: str) -> bool:
    """True if an absolute node name fits a key of a parameter file: ``*`` is one token, ``**`` any number."""
    expression = re.escape(absolute(pattern)).replace(r"/\*\*", r"(/\w+)*").replace(r"\*", r"\w+")
    return re.fullmatch(expression, name) is not None


def _compose(text: str, what: str) -> Any:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        return YAML(typ="safe", pure=True).compose(text)
    except YAMLError as error:
        raise YamlError(f"{what} is not valid YAML: {str(error).splitlines()[0]}") from error


def _collect_nodes(node: Any, prefix: str, result: dict[str, dict[str, Any]], path: str) -> None:
    if node.id != "mapping":
        raise YamlError(f"parameter file {path}: expected node names at line {node.start_mark.line + 1}")
    for key, content in node.value:
        if key.value == _PARAMETERS_KEY:
            if not prefix:
                raise YamlError(f"parameter file {path}: {_PARAMETERS_KEY} must be below a node name")
            _collect_parameters(content, "", result.setdefault(prefix, {}), path)
        else:
            _collect_nodes(content, f"{prefix.rstrip('/')}{absolute(key.value)}", result, path)


def _collect_parameters(node: Any, prefix: str, result: dict[str, Any], path: str) -> None:
    if node.id != "mapping":
        if prefix or node.value:
            raise YamlError(f"parameter file {path}: expected parameters at line {node.start_mark.line + 1}")
        return
    for key, content in node.value:
        name = f"{prefix}{key.value}"
        if content.id == "mapping":
            _collect_parameters(content, f"{name}.", result, path)
        else:
            result[name] = _value(content, f"parameter file {path}: {name}")


def _value(node: Any, what: str) -> Any:
    if node.id == "scalar":
        return _scalar_of(node)
    if node.id != "sequence":
        raise YamlError(f"{what} must be a scalar or a list")
    values = []
    for item in node.value:
        if item.id != "scalar":
            raise YamlError(f"{what} must hold scalars only")
        values.append(_scalar_of(item))
    kinds = {type(value) for value in values}
    if len(kinds) > 1:
        names = ", ".join(sorted(kind.__name__ for kind in kinds))
        raise YamlError(f"{what} must hold values of one type, got {names}")
    return values


def _scalar_of(node: Any) -> bool | int | float | str:
    quoted = node.style in ("'", '"', "|", ">")
    if quoted or (str(getattr(node, "tag", "")) in ("!!str", "tag:yaml.org,2002:str") and _is_tagged(node)):
        return str(node.value)
    return scalar(str(node.value))


def _is_tagged(node: Any) -> bool:
    # a resolved tag and a written one look alike; the text between the marks tells them apart
    start = node.start_mark
    buffer: str = getattr(start, "buffer", None) or ""
    return buffer[start.index : start.index + 2] == "!!"
