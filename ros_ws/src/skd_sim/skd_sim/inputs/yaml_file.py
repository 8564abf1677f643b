"""YAML files, read as YAML 1.2 has it, and with each key once."""

from __future__ import annotations

import re
import reprlib
import sys
from pathlib import Path
from typing import Any

import yaml

from skd_sim.errors import UsageError
from skd_sim.inputs.files import read_text

LARGEST = 256 * 1024
"""Bytes: a scenario has two thousand, a car model ten thousand; PyYAML reads about 100,000 a second."""
_short = reprlib.Repr()
_short.maxstring = _short.maxother = 60
_short.maxlevel = 2

_SCALARS = {  # YAML 1.2.2, 10.3.2 (core schema); in YAML 1.1, PyYAML's, 013 is 11, 1:30 is 90, on is true, 1e3 a text
    "null": (r"~|null|Null|NULL|", "~nN\0"),
    "bool": (r"true|True|TRUE|false|False|FALSE", "tTfF"),
    "int": (r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+", "-+0123456789"),
    "float": (
        r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        "-+.0123456789",
    ),
}


class _Loader(yaml.SafeLoader):
    """Plain data by YAML 1.2, and each key once."""

    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012 - none of YAML 1.1

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        """Return a whole number: 013 is 13, and 0o13 is 11."""
        return int(node.value, {"0o": 8, "0x": 16}.get(node.value[:2], 10))

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        # PyYAML takes the last of two equal keys, and a reader of the file may see the first.
        found: dict[Any, Any] = super().construct_mapping(node, deep=deep)
        if len(found) != len(node.value):
            seen = set()
            for name, _ in node.value:
                key = self.construct_object(name, deep=deep)
                if key in seen:
                    said = f"the key {name_of_key(key)} stands there twice: remove one"
                    raise yaml.constructor.ConstructorError(None, None, said, name.start_mark)
                seen.add(key)
        return found


class _Dumper(yaml.SafeDumper):
    """Plain data that read the same by YAML 1.1 and 1.2: what either takes for no text is in quotation marks."""


_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_yaml_int)
for _name, (_pattern, _first) in _SCALARS.items():
    for _class in (_Loader, _Dumper):
        _class.add_implicit_resolver(
            f"tag:yaml.org,2002:{_name}", re.compile(f"^(?:{_pattern})$"), [*_first.replace("\0", ""), ""]
        )


def read_yaml(path: Path) -> Any:
    """Return the plain data of a YAML file of at most `LARGEST` bytes; see `parse_yaml`.

    Raises:
        UsageError: it cannot be read, is too large, or is no YAML.
    """
    return parse_yaml(read_text(path, LARGEST), str(path))


def parse_yaml(text: str, where: str) -> Any:
    """Return what YAML says, as plain data.

    Args:
        text: content of the file.
        where: file or other origin, for messages.

    Raises:
        UsageError: it is no YAML, or more than data of that kind needs.
    """
    try:
        # The loader can make nothing but plain data: it is PyYAML's safe one.
        return yaml.load(text, _Loader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: a number or a date that is none
        raise UsageError(f"{where}: not valid YAML: {' '.join(str(error).split())[:300]}") from error


def to_yaml(data: Any) -> str:
    """Return plain data as YAML that `parse_yaml` reads."""
    return str(yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=120))


def as_yaml(text: str) -> str:
    """Return a text as YAML has it within a line: in quotation marks unless it is a word."""
    if re.fullmatch(r"[A-Za-z./][\w./-]*", text, re.ASCII) and to_yaml([text]) == f"- {text}\n":
        return text
    return str(yaml.dump(text, default_style='"', allow_unicode=True, width=sys.maxsize)).strip()


def short(value: object) -> str:
    """Return what a value looks like, in one line that is never long."""
    return " ".join(_short.repr(value).split())[:200]


def name_of_key(key: object) -> str:
    """Return a key as it stands in the file, in one line that is never long."""
    return " ".join(key.split())[:60] if isinstance(key, str) else short(key)
