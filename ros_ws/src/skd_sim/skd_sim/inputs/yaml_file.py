"""YAML of a user's, read with care: what it says is data of a page or two, whatever the file is."""

from __future__ import annotations

import contextlib
import errno
import os
import reprlib
import sys
from pathlib import Path
from typing import Any

import yaml

from skd_sim.errors import UsageError
from skd_sim.inputs.outside import LARGEST_WHOLE, open_regular

LARGEST = 256 * 1024
"""Bytes: a scenario has two thousand, a car model ten thousand; PyYAML reads about 100,000 a second."""
_DEEPEST = 50

_short = reprlib.Repr()
_short.maxstring = _short.maxother = 60
_short.maxlevel = 2


class _Loader(yaml.SafeLoader):
    """Plain data without aliases, by which a short text can mean gigabytes, without deep nesting, each key once."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise yaml.composer.ComposerError(None, None, "aliases (*) are not allowed: write it out", self._mark())
        self._depth = getattr(self, "_depth", 0) + 1
        if self._depth > _DEEPEST:
            raise yaml.composer.ComposerError(None, None, f"more than {_DEEPEST} levels", self._mark())
        try:
            node: yaml.Node | None = super().compose_node(parent, index)
        finally:
            self._depth -= 1
        return node

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        """Return a whole number of at most 64 bits: no such file needs more, and not all code can compare more."""
        value: int = super().construct_yaml_int(node)
        if abs(value) > LARGEST_WHOLE:
            raise yaml.constructor.ConstructorError(
                None, None, f"{node.value[:40]} has more than 64 bits", node.start_mark
            )
        return value

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

    def _mark(self) -> yaml.Mark:
        parser: Any = self  # PyYAML's parser has no types
        mark: yaml.Mark = parser.peek_event().start_mark
        return mark


_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_yaml_int)


def read_text(path: Path) -> str:
    """Return the text of a file of at most `LARGEST` bytes.

    Raises:
        OSError: it cannot be read, or is no file or no text in UTF-8.
        UsageError: it is longer.
    """
    if not path.exists():
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))
    try:
        with open_regular(path) as file:
            content = file.read(LARGEST + 1)
    except UsageError as error:
        raise OSError(0, "not a file") from error  # a pipe would have us wait
    if len(content) > LARGEST:
        raise UsageError(f"{path}: longer than {LARGEST // 1024} KiB, which no such file needs")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise OSError(0, "not a text in UTF-8") from error


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


def as_yaml(text: str) -> str:
    """Return a text as YAML has it that `parse_yaml` reads: in one line, in quotation marks where it needs them.

    Raises:
        UsageError: no YAML can say it.
    """
    for style in (None, '"'):
        found = yaml.safe_dump(text, default_style=style, allow_unicode=True, width=sys.maxsize)
        found = found.removesuffix("\n").removesuffix("\n...")
        with contextlib.suppress(UsageError):
            if len(found.splitlines()) == 1 and parse_yaml(f"- key: {found}\n", "") == [{"key": text}]:
                return found
    raise UsageError(f"{short(text)}: cannot be written as YAML; give the file another name")


def short(value: object) -> str:
    """Return what a value looks like, in one line that is never long."""
    return " ".join(_short.repr(value).split())[:200]


def name_of_key(key: object) -> str:
    """Return a key as it stands in the file, in one line that is never long."""
    return " ".join(key.split())[:60] if isinstance(key, str) else short(key)
